//! The requests of a person or a program to the service.

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

/// The largest number of requests that wait for the service, and of requests to disarm besides.
const WAITING: usize = 64;

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
    /// What the centre of the fleet has decided.
    Centre(CentreAsk),
    /// Correct by a model that a person has chosen.
    Model(Box<ModelAsk>),
}

/// A model that a person has chosen on the page *Model*.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelAsk {
    /// The machine file, on disk.
    pub machine: PathBuf,
    /// The hash that it must have.
    pub hash: String,
    /// Where it comes from.
    pub from: ModelSource,
    /// The same in words.
    pub file: String,
    /// The hash that a person confirms.
    pub confirm: Option<String>,
    /// In which ways it may be of another machine.
    pub differences: Differences,
}

/// What the centre of a fleet asks of the service.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CentreAsk {
    /// Correct by this machine file from now on; with the hash of a model that a person has confirmed at the centre.
    Take {
        /// The machine file, on disk and checked against its checksum.
        machine: PathBuf,
        /// The hash that was confirmed.
        confirm: Option<String>,
    },
    /// Ramp the correction to zero, and forbid arming from now on.
    Disable,
    /// Allow arming again.
    Enable,
    /// Write down that a manifest was refused, and why.
    Refused(String),
    /// Write down and show that what was accepted before cannot be used, and why.
    Damaged(String),
}

impl Ask {
    /// Whether it disarms, which is carried out when the request is made.
    pub fn disarms(&self) -> bool {
        matches!(self, Self::Disarm | Self::Centre(CentreAsk::Disable))
    }
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
    /// A request of `who`: the name of a token, `signal`, `auto_arm` or `centre` with the beginning of a key. Without an `answer` it is answered into the log
    /// of the program. A request to disarm is carried out here and now.
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

/// Where requests to the service go. As many places again are for disarming alone, so that other requests never keep it
/// from being written down.
#[derive(Clone)]
pub struct Asks {
    asked: SyncSender<Asked>,
    /// The number of requests that wait, but for disarming.
    others: Arc<AtomicUsize>,
}

/// The requests that wait for the service, in their order.
pub struct Queue {
    asked: Receiver<Asked>,
    others: Arc<AtomicUsize>,
}

/// Where requests go, and where they come out.
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
    /// Hands a request to the service.
    ///
    /// # Errors
    /// Too many wait, or the service has ended: the request comes back.
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
    /// The next request, waited for.
    ///
    /// # Errors
    /// None came in this time, or nobody can ask any more.
    pub fn recv_timeout(&self, wait: Duration) -> Result<Asked, RecvTimeoutError> {
        let asked = self.asked.recv_timeout(wait)?;
        if !asked.ask.disarms() {
            self.others.fetch_sub(1, Ordering::Relaxed);
        }
        Ok(asked)
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

/// A refusal in words.
pub(crate) fn refused(status: u16, why: impl Into<String>) -> Reply {
    Reply {
        status,
        answer: Answer::Refusal(Refusal::new(why)),
    }
}
