//! Cancels the requests that run or wait.

use std::sync::{
    Arc,
    atomic::{AtomicU64, Ordering},
};

use crate::error::StudioError;

/// Counts the cancellations. Work is cancelled if there was one since it began; so none can hit a later request.
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

    /// Called before the first file is written: a set of files is written whole or not at all.
    pub(crate) fn check(&self) -> Result<(), StudioError> {
        if self.is_cancelled() { Err(StudioError::Cancelled) } else { Ok(()) }
    }
}
