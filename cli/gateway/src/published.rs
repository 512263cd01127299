//! Data published by the service and read by the dashboard.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_port::Clock;
use volcomp_runtime::{Model, Pulse};

use crate::{
    documents::{FleetState, History, HistoryPoint, Status, round},
    locked, observe,
};

/// Maximum interval between two publications. A state older than this plus [`Pulse::patience`] is
/// stale, whichever of the two threads is late.
const PUBLISHED_EVERY: Duration = Duration::from_millis(150);
const SPAN_S: f64 = 120.0;
const STEP_S: f64 = 0.25;

/// Reading side, used by the dashboard.
#[derive(Clone)]
pub struct Published {
    shared: Arc<Shared>,
    pulse: Pulse,
}

/// Writing side, used by the service.
pub struct Publisher {
    shared: Arc<Shared>,
}

struct Shared {
    model: Mutex<Arc<Model>>,
    trend: Mutex<Trend>,
    /// The latest state, with the time of its cycle.
    latest: Mutex<(Arc<Status>, Instant)>,
    /// State of the fleet connection; `None`: not part of a fleet.
    fleet: Mutex<Option<FleetState>>,
}

/// Creates the publisher and the published state, with an initial state. `pulse` shows whether the control thread is alive.
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
    /// Publishes the state of a cycle and adds it to the history.
    pub fn publish(&self, status: Status, cycle_at: Instant) {
        locked(&self.shared.trend).add(&status);
        *locked(&self.shared.latest) = (Arc::new(status), cycle_at);
    }

    /// Publishes a new model, for the error map.
    pub fn set_model(&self, model: Arc<Model>) {
        *locked(&self.shared.model) = model;
    }
}

impl Published {
    /// The clock of the cycle.
    pub fn clock(&self) -> &Clock {
        self.pulse.clock()
    }

    /// The current state with its age: that of the last cycle, or `unknown` if there has been no cycle for three
    /// periods ([`Pulse::patience`]).
    pub fn latest(&self) -> Status {
        let (status, cycle_at) = {
            let latest = locked(&self.shared.latest);
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
        status.fleet.clone_from(&locked(&self.shared.fleet));
        status
    }

    /// Publishes the state of the fleet connection.
    pub fn set_fleet(&self, state: FleetState) {
        *locked(&self.shared.fleet) = Some(state);
    }

    /// Changes the published state of the fleet connection.
    pub fn update_fleet(&self, change: impl FnOnce(&mut FleetState)) {
        if let Some(state) = locked(&self.shared.fleet).as_mut() {
            change(state);
        }
    }

    /// The active model, without its temperatures.
    pub fn model(&self) -> Arc<Model> {
        Arc::clone(&locked(&self.shared.model))
    }

    /// The history of the last two minutes.
    pub fn history(&self) -> History {
        locked(&self.shared.trend).history()
    }
}

#[derive(Debug, Default)]
struct Trend {
    points: VecDeque<HistoryPoint>,
}

impl Trend {
    /// Adds a state as a point unless the last point is too recent. Expired points are dropped.
    fn add(&mut self, status: &Status) {
        let now = status.uptime_s;
        if let Some(last) = self.points.back() {
            if now < last.at_s {
                // The uptime has restarted.
                self.points.clear();
            } else if now - last.at_s < STEP_S {
                return;
            }
        }
        while self
            .points
            .front()
            .is_some_and(|first| now - first.at_s > SPAN_S)
        {
            self.points.pop_front();
        }
        let length =
            |v: Option<[f64; 3]>| v.map(|v| round(v.iter().map(|x| x * x).sum::<f64>().sqrt()));
        self.points.push_back(HistoryPoint {
            at_s: now,
            error_um: length(status.true_error_um.or(status.error_um)),
            residual_um: length(status.true_residual_um.or(status.residual_um)),
            error_axis_urad: length(status.error_axis_urad),
            residual_axis_urad: length(status.residual_axis_urad),
        });
    }

    fn history(&self) -> History {
        History {
            span_s: SPAN_S,
            points: self.points.iter().copied().collect(),
        }
    }
}
