//! State shared by the threads of the models.

use std::{
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    time::{Duration, Instant},
};

use tokio::sync::oneshot;
use volcomp_runtime::DisarmSwitch;

use super::store::Store;
use crate::{
    documents::{Candidate, ConfiguredModel, ModelEntry, ModelSource, ModelsKept},
    published::Published,
    request::{Asks, Reply, refused},
};

/// State shared by the threads. No holder of its locks waits for a disk.
pub(super) struct Shared {
    pub(super) store: Store,
    /// True for the built-in simulation, whose machine file cannot be replaced.
    pub(super) is_built_in: bool,
    pub(super) cycle_cpu: Option<usize>,
    pub(super) published: Published,
    pub(super) asks: Asks,
    pub(super) switch: DisarmSwitch,
    pub(super) told: Mutex<Told>,
    pub(super) candidate: Mutex<Option<Held>>,
    pub(super) uploading: AtomicUsize,
    /// Whether a comparison is running, even if its candidate was discarded.
    pub(super) is_comparing: AtomicBool,
}

/// State of the desk shown on the dashboard.
#[derive(Default)]
pub(super) struct Told {
    pub(super) kept: ModelsKept,
    /// Hashes of the models on disk.
    pub(super) there: Vec<String>,
    /// Origin of the active model.
    pub(super) from: ModelSource,
    pub(super) configured: ConfiguredModel,
    pub(super) trouble: Option<String>,
}

/// The model to activate.
pub(super) enum Activate {
    /// The uploaded candidate.
    Candidate {
        id: String,
        hash: String,
        text: String,
        file: String,
    },
    /// A stored model, by its hash.
    Kept(String),
    /// The machine file named in the configuration, as it is on disk.
    Configured,
}

pub(super) enum Job {
    /// The outcome of a model, with its machine file if it was activated.
    Noted(Box<ModelEntry>, Option<String>),
    /// The configuration now names this machine file.
    Configured(PathBuf),
    Activate {
        who: String,
        what: Activate,
        confirm: Option<String>,
        answer: oneshot::Sender<Reply>,
        patience: Patience,
    },
}

/// The candidate and its machine file.
pub(super) struct Held {
    pub(super) document: Candidate,
    /// The text to be stored; `None` until the file was parsed.
    pub(super) text: Option<String>,
}

/// Timeout until the request is passed to the service. A request delayed by a disk that hangs must not take effect
/// later, unexpectedly: the client receives the timeout before the request becomes too old for a response.
const WITHIN: Duration = Duration::from_secs(5);

/// The deadline of one request. Invariant: the request is either passed to the service or given up, never both.
#[derive(Clone, Debug)]
pub(super) struct Patience {
    until: Instant,
    is_decided: Arc<AtomicBool>,
}

impl Patience {
    /// Starts the timeout.
    pub(super) fn begin() -> Self {
        Self {
            until: Instant::now() + WITHIN,
            is_decided: Arc::default(),
        }
    }

    pub(super) fn left(&self) -> Duration {
        self.until.saturating_duration_since(Instant::now())
    }

    /// Claims the request for the service; `false` if it has timed out or was given up.
    pub(super) fn lets_go_on(&self) -> bool {
        !self.left().is_zero() && !self.is_decided.swap(true, Ordering::AcqRel)
    }

    /// Gives the request up; `false` if it has already been passed to the service.
    pub(super) fn gives_up(&self) -> bool {
        !self.is_decided.swap(true, Ordering::AcqRel)
    }
}

pub(super) const BUILT_IN: &str = "the built-in simulation has its own machine file, which no other one can replace; start the gateway with a configuration, which may name a simulated control";

/// The refusal after a timeout of the disk.
pub(super) const GIVEN_UP: &str = "the disk with the models has not answered in time: the model was not put in force, and will not be later. Try again once it answers";

/// The refusal of a request for a candidate that no longer exists.
pub(super) fn gone() -> Reply {
    refused(
        409,
        "this machine file is not here any more: it was discarded, or put in force",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_goes_on_or_is_given_up() {
        let patience = Patience::begin();
        let of_desk = patience.clone();
        assert!(of_desk.lets_go_on());
        assert!(!patience.gives_up(), "its answer comes from the service");
        let patience = Patience::begin();
        let of_desk = patience.clone();
        assert!(patience.gives_up());
        assert!(!of_desk.lets_go_on());
        // Nobody gave it up, and it is late.
        let late = Patience {
            until: Instant::now(),
            is_decided: Arc::default(),
        };
        assert!(!late.lets_go_on());
    }
}
