//! Cancels requests that run or wait.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use crate::error::StudioError;

/// Counts the cancellations. A request is cancelled if the count has changed since it began, so a cancellation never
/// affects a later request.
#[derive(Clone, Debug, Default)]
pub(crate) struct Interrupt {
    cancellations: Arc<AtomicU64>,
    at_begin: u64,
}

impl Interrupt {
    /// The interrupt of a request that begins now.
    pub(crate) fn of_request(&self) -> Self {
        let cancellations = Arc::clone(&self.cancellations);
        Self { at_begin: cancellations.load(Ordering::SeqCst), cancellations }
    }

    /// Cancels every request that has begun.
    pub(crate) fn cancel(&self) {
        self.cancellations.fetch_add(1, Ordering::SeqCst);
    }

    pub(crate) fn is_cancelled(&self) -> bool {
        self.cancellations.load(Ordering::SeqCst) != self.at_begin
    }

    /// Called before the first file of a set is written, so that a set is written completely or not at all.
    pub(crate) fn check(&self) -> Result<(), StudioError> {
        if self.is_cancelled() { Err(StudioError::Cancelled) } else { Ok(()) }
    }
}
