//! The requests of a person or a program to the service.

use tokio::sync::oneshot;
use volcomp_runtime::DisarmSwitch;

use crate::documents::Answer;

/// The action that somebody asks the service for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ask {
    /// Correct; with the hash of a model that a person confirms.
    Arm(Option<String>),
    /// Ramp the correction to zero and stop correcting.
    Disarm,
    /// The cause of a fault is mended.
    Acknowledge,
    /// Read configuration and machine file again; with the hash of a model that a person confirms.
    Reload(Option<String>),
}

/// A request, and where its answer goes. Disarming is ordered already when a request for it has been made: the service
/// only writes it down and answers.
pub struct Asked {
    pub(crate) ask: Ask,
    pub(crate) who: String,
    pub(crate) answer: Option<oneshot::Sender<Reply>>,
    /// How often disarming had been ordered when the request was made.
    pub(crate) disarms: u64,
}

impl Asked {
    /// A request of `who`: the name of a token, `signal` or `auto_arm`. Without an `answer` it is answered into the log
    /// of the program. A request to disarm is carried out here and now.
    pub fn new(
        ask: Ask,
        who: impl Into<String>,
        answer: Option<oneshot::Sender<Reply>>,
        switch: &DisarmSwitch,
    ) -> Self {
        if ask == Ask::Disarm {
            switch.disarm();
        }
        Self {
            ask,
            who: who.into(),
            answer,
            disarms: switch.count(),
        }
    }
}

/// A status of HTTP and the document that goes with it.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// 200 for a request that took effect, 409 for one that did not, 422 for a configuration that is wrong, 503 while
    /// the control thread or the disk does not answer.
    pub status: u16,
    /// The document of the answer.
    pub answer: Answer,
}
