//! Requests from operators and programs to the service.

use std::{
    path::PathBuf,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
        mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel},
    },
    time::Duration,
};

use tokio::sync::oneshot;
use volcomp_runtime::DisarmSwitch;

use crate::{
    differences::Differences,
    documents::{Answer, ModelSource, Refusal},
};

/// Maximum number of queued requests; disarm requests have as many slots of their own.
const WAITING: usize = 64;

/// The requested action.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ask {
    /// Start correcting; with the hash of a confirmed model.
    Arm(Option<String>),
    /// Ramp the correction to zero and stop correcting.
    Disarm,
    /// The cause of a fault has been fixed.
    Acknowledge,
    /// Reload configuration and machine file; with the hash of a confirmed model.
    Reload(Option<String>),
    /// A decision of the fleet's centre.
    Centre(CentreAsk),
    /// Correct with a model selected by an operator.
    Model(Box<ModelAsk>),
}

/// A model selected on the page *Model*.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelAsk {
    /// Path of the machine file.
    pub machine: PathBuf,
    /// Expected hash.
    pub hash: String,
    /// Origin of the model.
    pub from: ModelSource,
    /// Description of the origin.
    pub file: String,
    /// The confirmed hash.
    pub confirm: Option<String>,
    /// Signs that it belongs to another machine.
    pub differences: Differences,
}

/// A request of the centre of a fleet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CentreAsk {
    /// Correct with this machine file; with the hash of a model that was confirmed at the centre.
    Take {
        /// Path of the machine file, verified against its checksum.
        machine: PathBuf,
        /// The confirmed hash.
        confirm: Option<String>,
    },
    /// Ramp the correction to zero and forbid arming.
    Disable,
    /// Permit arming again.
    Enable,
    /// Record that a manifest was refused, and why.
    Refused(String),
    /// Record and show that an accepted manifest is unusable, and why.
    Damaged(String),
}

impl Ask {
    /// Whether the request disarms; disarming takes effect when the request is created.
    pub fn disarms(&self) -> bool {
        matches!(self, Self::Disarm | Self::Centre(CentreAsk::Disable))
    }
}

/// A request and the channel for its response. Creating a request to disarm already orders it; the service only records
/// it and responds.
pub struct Asked {
    pub(crate) ask: Ask,
    pub(crate) who: String,
    pub(crate) answer: Option<oneshot::Sender<Reply>>,
    /// Number of disarm orders at the time of the request.
    pub(crate) disarms: u64,
}

impl Asked {
    /// Creates a request of `who`: the name of a token, `signal`, `auto_arm`, or `centre` with the first digits of a
    /// key. Without `answer`, the response is logged. A request to disarm takes effect immediately.
    pub fn new(
        ask: Ask,
        who: impl Into<String>,
        answer: Option<oneshot::Sender<Reply>>,
        switch: &DisarmSwitch,
    ) -> Self {
        if ask.disarms() {
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

/// Sending side of the request queue. Slots are reserved for disarm requests, so that other requests never prevent them
/// from being recorded.
#[derive(Clone)]
pub struct Asks {
    asked: SyncSender<Asked>,
    /// Number of queued requests, without those to disarm.
    others: Arc<AtomicUsize>,
}

/// Receiving side of the request queue, in order of arrival.
pub struct Queue {
    asked: Receiver<Asked>,
    others: Arc<AtomicUsize>,
}

/// Creates a request queue.
#[must_use]
pub fn queue() -> (Asks, Queue) {
    let (send, asked) = sync_channel(2 * WAITING);
    let others = Arc::new(AtomicUsize::new(0));
    let asks = Asks {
        asked: send,
        others: Arc::clone(&others),
    };
    (asks, Queue { asked, others })
}

impl Asks {
    /// Queues a request.
    ///
    /// # Errors
    /// The queue is full, or the service has ended: the request is returned.
    pub fn try_send(&self, asked: Asked) -> Result<(), TrySendError<Asked>> {
        if asked.ask.disarms() {
            return self.asked.try_send(asked);
        }
        let more = |waiting| (waiting < WAITING).then_some(waiting + 1);
        let place = self
            .others
            .fetch_update(Ordering::Relaxed, Ordering::Relaxed, more);
        if place.is_err() {
            return Err(TrySendError::Full(asked));
        }
        let sent = self.asked.try_send(asked);
        if sent.is_err() {
            self.others.fetch_sub(1, Ordering::Relaxed);
        }
        sent
    }
}

impl Queue {
    /// Waits for the next request.
    ///
    /// # Errors
    /// The timeout has passed, or all senders were dropped.
    pub fn recv_timeout(&self, wait: Duration) -> Result<Asked, RecvTimeoutError> {
        let asked = self.asked.recv_timeout(wait)?;
        if !asked.ask.disarms() {
            self.others.fetch_sub(1, Ordering::Relaxed);
        }
        Ok(asked)
    }
}

/// An HTTP status with its document.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// 200: the request took effect; 409: it did not; 422: the configuration is invalid; 503: the control thread or the
    /// disk does not respond.
    pub status: u16,
    /// The response document.
    pub answer: Answer,
}

/// A refusal with its reason.
pub(crate) fn refused(status: u16, why: impl Into<String>) -> Reply {
    Reply {
        status,
        answer: Answer::Refusal(Refusal::new(why)),
    }
}
