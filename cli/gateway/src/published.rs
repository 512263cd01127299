//! The data that the service publishes and the dashboard reads.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use volcomp_runtime::{Model, Pulse};

use crate::{
    documents::{FleetState, History, Status},
    history::Trend,
    observe,
};

/// The service publishes so often at least; a state that is older than this and the patience with the control thread
/// says nothing of the present, whichever of the two threads is late.
const PUBLISHED_EVERY: Duration = Duration::from_millis(150);

/// The side of the dashboard.
#[derive(Clone)]
pub struct Published {
    shared: Arc<Shared>,
    /// The sign of life of the control thread.
    pulse: Pulse,
}

/// The side of the service.
pub struct Publisher {
    shared: Arc<Shared>,
}

struct Shared {
    /// The model, for the error map.
    model: Mutex<Arc<Model>>,
    trend: Mutex<Trend>,
    /// The latest state, and the time of its cycle.
    latest: Mutex<(Arc<Status>, Instant)>,
    /// The fleet as this machine sees it; `None`: it is in none.
    fleet: Mutex<Option<FleetState>>,
}

/// Both sides, with a first state. `pulse` tells whether the control thread lives.
pub fn published(first: Status, model: Arc<Model>, pulse: Pulse) -> (Publisher, Published) {
    let shared = Arc::new(Shared {
        model: Mutex::new(model),
        trend: Mutex::default(),
        latest: Mutex::new((Arc::new(first), pulse.clock().now())),
        fleet: Mutex::default(),
    });
    let reader = Published {
        shared: Arc::clone(&shared),
        pulse,
    };
    (Publisher { shared }, reader)
}

impl Publisher {
    /// Publishes the state of a cycle, which becomes a point of the history.
    pub fn publish(&self, status: Status, cycle_at: Instant) {
        lock(&self.shared.trend).add(&status);
        *lock(&self.shared.latest) = (Arc::new(status), cycle_at);
    }

    /// Publishes another model, for the error map.
    pub fn set_model(&self, model: Arc<Model>) {
        *lock(&self.shared.model) = model;
    }
}

impl Published {
    /// The state of now, with its age: that of the last cycle, or `unknown` where there has been none for three
    /// periods ([`Pulse::patience`]).
    pub fn latest(&self) -> Status {
        let (status, cycle_at) = {
            let latest = lock(&self.shared.latest);
            (Arc::clone(&latest.0), latest.1)
        };
        let mut status = Status::clone(&status);
        let now = self.pulse.clock().now();
        let age = now.saturating_duration_since(cycle_at);
        observe::age(&mut status, age);
        let stale = Some(age).filter(|age| *age > self.pulse.patience() + PUBLISHED_EVERY);
        if let Some(silence) = self.pulse.silence().or(stale) {
            observe::silence(&mut status, silence);
        }
        status.fleet.clone_from(&lock(&self.shared.fleet));
        status
    }

    /// Publishes how it stands with the fleet.
    pub fn set_fleet(&self, state: FleetState) {
        *lock(&self.shared.fleet) = Some(state);
    }

    /// Publishes a change of how it stands with the fleet.
    pub fn tell_fleet(&self, change: impl FnOnce(&mut FleetState)) {
        if let Some(state) = lock(&self.shared.fleet).as_mut() {
            change(state);
        }
    }

    /// The model that corrects, without its temperatures.
    pub fn model(&self) -> Arc<Model> {
        Arc::clone(&lock(&self.shared.model))
    }

    /// The trend of the last minutes.
    pub fn history(&self) -> History {
        lock(&self.shared.trend).history()
    }
}

/// Nothing that holds one of these locks can panic in the middle of a change.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
