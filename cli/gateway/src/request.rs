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
    documents::{Answer, ModelSource, Refusal},
    identity::Differences,
};

/// Maximum number of queued requests. Requests to disarm have further slots of the same number.
const MAX_QUEUED: usize = 64;

/// The requested action.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Operation {
    /// Start correcting; `Some` holds the hash of the model that the operator confirmed.
    Arm(Option<String>),
    /// Ramp the correction to zero and stop correcting.
    Disarm,
    /// Acknowledge a fault whose cause is fixed.
    Acknowledge,
    /// Reload configuration and machine file; `Some` holds the hash of the model that the operator
    /// confirmed.
    Reload(Option<String>),
    /// A decision of the fleet's centre.
    Centre(CentreOperation),
    /// Correct with a model selected by an operator.
    Model(Box<ModelActivation>),
}

/// A model selected in the web interface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModelActivation {
    pub machine: PathBuf,
    /// Hash that the machine file must have.
    pub hash: String,
    /// How the model reached the gateway.
    pub from: ModelSource,
    /// Path of the machine file, or the file name of the upload.
    pub file: String,
    /// Hash that the user confirmed; `None`: nothing was confirmed.
    pub confirm: Option<String>,
    /// Signs that the machine file belongs to another machine.
    pub differences: Differences,
}

/// A request of the centre of a fleet.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum CentreOperation {
    /// Correct with this machine file; `confirm` is the hash of a model confirmed at the centre.
    Take {
        /// Path of the machine file, verified against its checksum.
        machine: PathBuf,
        /// The confirmed hash; `None`: nothing was confirmed.
        confirm: Option<String>,
    },
    /// Ramp the correction to zero and forbid arming.
    Disable,
    /// Permit arming again.
    Enable,
    /// Record that a manifest was refused, with the reason.
    Refused(String),
    /// Record and show that an accepted manifest is unusable, with the reason.
    Damaged(String),
}

impl Operation {
    /// True if the request disarms. Disarming takes effect when the request is created.
    pub fn disarms(&self) -> bool {
        matches!(self, Self::Disarm | Self::Centre(CentreOperation::Disable))
    }
}

/// A request and the channel for its response. Creating a request to disarm already passes the order to the control
/// thread; the service only records the request and responds.
pub struct ServiceRequest {
    pub(crate) operation: Operation,
    pub(crate) who: String,
    pub(crate) answer: Option<oneshot::Sender<Reply>>,
    pub(crate) disarms: u64,
}

impl ServiceRequest {
    /// Creates a request of `who`: the name of a token, `signal`, `auto_arm`, or `centre` with the first digits of a
    /// key. Without `answer`, the response is logged. A request to disarm takes effect immediately.
    pub fn new(
        operation: Operation,
        who: impl Into<String>,
        answer: Option<oneshot::Sender<Reply>>,
        switch: &DisarmSwitch,
    ) -> Self {
        if operation.disarms() {
            switch.disarm();
        }
        Self { operation, who: who.into(), answer, disarms: switch.count() }
    }
}

/// Sending side of the request queue. Slots are reserved for requests to disarm, so that other requests never prevent
/// the service from recording them.
#[derive(Clone)]
pub struct RequestSender {
    queue: SyncSender<ServiceRequest>,
    /// Number of queued requests that do not disarm.
    others: Arc<AtomicUsize>,
}

/// Receiving side of the request queue, in order of arrival.
pub struct RequestQueue {
    queue: Receiver<ServiceRequest>,
    others: Arc<AtomicUsize>,
}

#[must_use]
pub fn queue() -> (RequestSender, RequestQueue) {
    let (sender, queue) = sync_channel(2 * MAX_QUEUED);
    let others = Arc::new(AtomicUsize::new(0));
    let requests = RequestSender { queue: sender, others: Arc::clone(&others) };
    (requests, RequestQueue { queue, others })
}

impl RequestSender {
    /// Queues a request.
    ///
    /// # Errors
    /// The queue is full, or the service has ended: the request is returned.
    pub fn try_send(&self, request: ServiceRequest) -> Result<(), TrySendError<ServiceRequest>> {
        if request.operation.disarms() {
            return self.queue.try_send(request);
        }
        let more = |waiting| (waiting < MAX_QUEUED).then_some(waiting + 1);
        let place = self.others.fetch_update(Ordering::Relaxed, Ordering::Relaxed, more);
        if place.is_err() {
            return Err(TrySendError::Full(request));
        }
        let sent = self.queue.try_send(request);
        if sent.is_err() {
            self.others.fetch_sub(1, Ordering::Relaxed);
        }
        sent
    }
}

impl RequestQueue {
    /// Waits for the next request.
    ///
    /// # Errors
    /// The timeout has passed, or all senders were dropped.
    pub fn recv_timeout(&self, wait: Duration) -> Result<ServiceRequest, RecvTimeoutError> {
        let request = self.queue.recv_timeout(wait)?;
        if !request.operation.disarms() {
            self.others.fetch_sub(1, Ordering::Relaxed);
        }
        Ok(request)
    }
}

/// An HTTP status with its document.
#[derive(Clone, Debug, PartialEq)]
pub struct Reply {
    /// 200: the request took effect; 409: it had no effect; 422: the configuration is invalid; 503: the control thread
    /// or the disk does not respond.
    pub status: u16,
    pub answer: Answer,
}

pub(crate) fn refused(status: u16, why: impl Into<String>) -> Reply {
    Reply { status, answer: Answer::Refusal(Refusal::new(why)) }
}
