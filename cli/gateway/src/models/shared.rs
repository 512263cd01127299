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
    request::{Reply, RequestSender, refused},
};

/// State shared by the threads. A thread that holds one of its locks never waits for a disk.
pub(super) struct Shared {
    pub(super) store: Store,
    /// True for the built-in simulation, whose machine file cannot be replaced.
    pub(super) is_built_in: bool,
    pub(super) cycle_cpu: Option<usize>,
    pub(super) published: Published,
    pub(super) requests: RequestSender,
    pub(super) switch: DisarmSwitch,
    pub(super) shown: Mutex<ShownModels>,
    pub(super) candidate: Mutex<Option<HeldCandidate>>,
    pub(super) uploading: AtomicUsize,
    /// True while a comparison is running, even if its candidate was discarded.
    pub(super) is_comparing: AtomicBool,
}

#[derive(Default)]
pub(super) struct ShownModels {
    pub(super) kept: ModelsKept,
    pub(super) stored: Vec<String>,
    pub(super) from: ModelSource,
    pub(super) configured: ConfiguredModel,
    pub(super) trouble: Option<String>,
}

pub(super) enum Activate {
    Candidate { id: String, hash: String, text: String, file: String },
    Kept(String),
    Configured,
}

pub(super) enum Job {
    Record(Box<ModelEntry>, Option<String>),
    Configured(PathBuf),
    Activate {
        who: String,
        what: Activate,
        confirm: Option<String>,
        answer: oneshot::Sender<Reply>,
        deadline: RequestDeadline,
    },
}

pub(super) struct HeldCandidate {
    pub(super) document: Candidate,
    /// The text to store; `None` until the file has been parsed.
    pub(super) text: Option<String>,
}

/// Timeout until a request is passed to the service. A request that a hanging disk delays must not take effect
/// unexpectedly after its client has received the timeout.
const ACTIVATION_TIMEOUT: Duration = Duration::from_secs(5);

/// The deadline of one request. Invariant: the request is either passed to the service or withdrawn, never both.
#[derive(Clone, Debug)]
pub(super) struct RequestDeadline {
    until: Instant,
    is_decided: Arc<AtomicBool>,
}

impl RequestDeadline {
    pub(super) fn start() -> Self {
        Self { until: Instant::now() + ACTIVATION_TIMEOUT, is_decided: Arc::default() }
    }

    pub(super) fn left(&self) -> Duration {
        self.until.saturating_duration_since(Instant::now())
    }

    /// Claims the request for the service; `false` if the request was withdrawn or has timed out.
    pub(super) fn claim(&self) -> bool {
        !self.left().is_zero() && !self.is_decided.swap(true, Ordering::AcqRel)
    }

    /// Withdraws the request; `false` if the service already has it.
    pub(super) fn withdraw(&self) -> bool {
        !self.is_decided.swap(true, Ordering::AcqRel)
    }
}

pub(super) const BUILT_IN: &str = "the machine file of the built-in simulation cannot be replaced; start the gateway with a configuration, which may name a simulated control";

pub(super) const GIVEN_UP: &str = "the disk with the models has not answered in time: the model was not activated, and will not be later. Try again once it answers";

pub(super) fn candidate_gone() -> Reply {
    refused(409, "this machine file is not here any more: it was discarded or activated")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_request_is_claimed_or_withdrawn() {
        let deadline = RequestDeadline::start();
        let of_desk = deadline.clone();
        assert!(of_desk.claim());
        assert!(!deadline.withdraw(), "its answer comes from the service");
        let deadline = RequestDeadline::start();
        let of_desk = deadline.clone();
        assert!(deadline.withdraw());
        assert!(!of_desk.claim());
        // The request was not withdrawn, but its deadline has passed.
        let late = RequestDeadline { until: Instant::now(), is_decided: Arc::default() };
        assert!(!late.claim());
    }
}
