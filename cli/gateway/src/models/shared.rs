//! What the threads of the models share: what is shown, what waits, and how long.

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

/// What the threads share. Nothing that holds one of its locks waits for a disk.
pub(super) struct Shared {
    pub(super) store: Store,
    /// The built-in simulation has its own machine file.
    pub(super) is_built_in: bool,
    pub(super) cycle_cpu: Option<usize>,
    pub(super) published: Published,
    pub(super) asks: Asks,
    pub(super) switch: DisarmSwitch,
    pub(super) told: Mutex<Told>,
    pub(super) candidate: Mutex<Option<Held>>,
    pub(super) uploading: AtomicUsize,
    /// Whether a machine file is being compared, also one that was discarded.
    pub(super) is_comparing: AtomicBool,
}

/// What the dashboard shows of the desk.
#[derive(Default)]
pub(super) struct Told {
    pub(super) kept: ModelsKept,
    /// The models that are on disk.
    pub(super) there: Vec<String>,
    /// Where the model in force comes from.
    pub(super) from: ModelSource,
    pub(super) configured: ConfiguredModel,
    pub(super) trouble: Option<String>,
}

/// What is to be put in force.
pub(super) enum Activate {
    /// What somebody has made.
    Candidate {
        id: String,
        hash: String,
        text: String,
        file: String,
    },
    /// A model that is kept, by its hash.
    Kept(String),
    /// The machine file that the configuration names, as it is on disk.
    Configured,
}

/// A piece of work for the desk.
pub(super) enum Job {
    /// What became of a model, and the machine file where it is in force.
    Noted(Box<ModelEntry>, Option<String>),
    /// The configuration names this machine file from now on.
    Configured(PathBuf),
    Activate {
        who: String,
        what: Activate,
        confirm: Option<String>,
        answer: oneshot::Sender<Reply>,
        patience: Patience,
    },
}

/// The candidate, and the machine file that is put in force.
pub(super) struct Held {
    pub(super) document: Candidate,
    /// The machine file as it is kept; `None` until it was read.
    pub(super) text: Option<String>,
}

/// The longest time until the service is asked. What waits for a disk that hangs is not done later, when nobody expects it any
/// more: whoever asked hears that it is given up before the request is too old to be answered.
const WITHIN: Duration = Duration::from_secs(5);

/// The patience for one request: either it goes to the service, or whoever asked gives it up. Never both.
#[derive(Clone, Debug)]
pub(super) struct Patience {
    until: Instant,
    is_decided: Arc<AtomicBool>,
}

impl Patience {
    /// It begins now.
    pub(super) fn begin() -> Self {
        Self {
            until: Instant::now() + WITHIN,
            is_decided: Arc::default(),
        }
    }

    /// How long it lasts from now on.
    pub(super) fn left(&self) -> Duration {
        self.until.saturating_duration_since(Instant::now())
    }

    /// Whether the request may go to the service now; it goes there then.
    pub(super) fn lets_go_on(&self) -> bool {
        !self.left().is_zero() && !self.is_decided.swap(true, Ordering::AcqRel)
    }

    /// Whether the request is given up now: it does not go to the service any more.
    pub(super) fn gives_up(&self) -> bool {
        !self.is_decided.swap(true, Ordering::AcqRel)
    }
}

pub(super) const BUILT_IN: &str = "the built-in simulation has its own machine file, which no other one can replace; start the gateway with a configuration, which may name a simulated control";

/// Why a model was not put in force where the disk has not answered in time.
pub(super) const GIVEN_UP: &str = "the disk with the models has not answered in time: the model was not put in force, and will not be later. Try again once it answers";

/// The answer where a request names a candidate that is not there any more.
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
