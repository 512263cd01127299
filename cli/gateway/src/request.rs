//! The requests of a person or a program to the service.

use tokio::sync::oneshot;

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

/// A request, and where its answer goes.
pub struct Asked {
    /// The action that is asked for.
    pub ask: Ask,
    /// Who asks: the name of a token, `signal` or `auto_arm`.
    pub who: String,
    /// Where the answer goes; `None`: into the log of the program.
    pub answer: Option<oneshot::Sender<Reply>>,
}

/// A status of HTTP and the document that goes with it.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// 200 for a request that took effect, 409 for one that did not, 422 for a configuration that is wrong, 503 while
    /// the control thread takes no orders.
    pub status: u16,
    /// The document of the answer.
    pub answer: Answer,
}
