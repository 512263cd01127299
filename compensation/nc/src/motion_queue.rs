//! Queue of executed motions between two threads. It passes them on in batches: waking a thread takes longer than executing a line.

use std::{
    cell::RefCell,
    mem::take,
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{Receiver, RecvError, SendError, SyncSender, sync_channel},
    },
    vec::IntoIter,
};

use crate::motion::ExecutedMotion;

/// Capacity of the queue, in batches; a full queue blocks the sender.
const WAITING: usize = 16;
/// Number of motions in a batch.
const BATCH: usize = 64;

/// Sends executed motions. Clones append to the same batch, which is sent when it is full or the last clone is dropped.
#[derive(Clone, Debug)]
pub(crate) struct MotionSender(Arc<Mutex<Batch>>);

#[derive(Debug)]
struct Batch {
    to: SyncSender<Vec<ExecutedMotion>>,
    motions: Vec<ExecutedMotion>,
}

#[derive(Debug)]
pub(crate) struct MotionReceiver {
    from: Receiver<Vec<ExecutedMotion>>,
    batch: RefCell<IntoIter<ExecutedMotion>>,
}

pub(crate) fn motion_queue() -> (MotionSender, MotionReceiver) {
    let (to, from) = sync_channel(WAITING);
    let motions = Vec::new();
    let sender = MotionSender(Arc::new(Mutex::new(Batch { to, motions })));
    let batch = RefCell::default();
    (sender, MotionReceiver { from, batch })
}

impl MotionSender {
    /// # Errors
    /// The receiver no longer exists.
    pub(crate) fn send(&self, made: ExecutedMotion) -> Result<(), SendError<Vec<ExecutedMotion>>> {
        let batch = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        batch.motions.push(made);
        if batch.motions.len() < BATCH {
            return Ok(());
        }
        let next = Vec::with_capacity(BATCH);
        batch.to.send(std::mem::replace(&mut batch.motions, next))
    }
}

impl Drop for Batch {
    fn drop(&mut self) {
        let last = take(&mut self.motions);
        if !last.is_empty() {
            // If the receiver no longer exists, the batch is not needed.
            let _ = self.to.send(last);
        }
    }
}

impl MotionReceiver {
    /// The next motion; waits until a motion is sent.
    ///
    /// # Errors
    /// All motions were received, and the sender no longer exists.
    pub(crate) fn recv(&self) -> Result<ExecutedMotion, RecvError> {
        let mut batch = self.batch.borrow_mut();
        if let Some(next) = batch.next() {
            return Ok(next);
        }
        *batch = self.from.recv()?.into_iter();
        // A batch is never empty.
        batch.next().ok_or(RecvError)
    }
}
