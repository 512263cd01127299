//! The data that the service publishes and the dashboard reads.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use tokio::sync::watch;
use volcomp_runtime::Model;

use crate::{
    documents::{History, Status},
    history::Trend,
};

/// The side of the dashboard.
#[derive(Clone)]
pub struct Published {
    /// The latest state, and when it changes.
    pub status: watch::Receiver<Arc<Status>>,
    shared: Arc<Shared>,
}

/// The side of the service.
pub struct Publisher {
    status: watch::Sender<Arc<Status>>,
    shared: Arc<Shared>,
}

struct Shared {
    /// The model, for the error map.
    model: Mutex<Arc<Model>>,
    trend: Mutex<Trend>,
}

/// Both sides, with a first state.
pub fn published(first: Status, model: Arc<Model>) -> (Publisher, Published) {
    let (status, read) = watch::channel(Arc::new(first));
    let shared = Arc::new(Shared {
        model: Mutex::new(model),
        trend: Mutex::default(),
    });
    let reader = Published {
        status: read,
        shared: Arc::clone(&shared),
    };
    (Publisher { status, shared }, reader)
}

impl Publisher {
    /// Publishes a state, which becomes a point of the history.
    pub fn publish(&self, status: Status) {
        lock(&self.shared.trend).add(&status);
        self.status.send_replace(Arc::new(status));
    }

    /// Publishes another model, for the error map.
    pub fn set_model(&self, model: Arc<Model>) {
        *lock(&self.shared.model) = model;
    }
}

impl Published {
    /// The state that was published last.
    pub fn latest(&self) -> Arc<Status> {
        Arc::clone(&self.status.borrow())
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
