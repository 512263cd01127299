//! Work that may wait for a disk or takes long: one piece at a time, on a thread of its own.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

/// Whether the last piece of work is still at it.
#[derive(Default)]
pub(super) struct Worker(Arc<AtomicBool>);

impl Worker {
    /// Waits until the last piece of work is done, for at most `patience`. Whether it is.
    pub(super) fn settle(&self, patience: Duration) -> bool {
        let end = Instant::now() + patience;
        while self.0.load(Ordering::Acquire) {
            if Instant::now() > end {
                return false;
            }
            thread::sleep(Duration::from_micros(100));
        }
        true
    }

    /// Begins a piece of work, whose result comes from the receiver. `None`: the last one is not done, or there is no
    /// thread to be had.
    pub(super) fn begin<T: Send + 'static>(
        &mut self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Option<Receiver<T>> {
        if self.0.swap(true, Ordering::AcqRel) {
            return None;
        }
        let (tell, told) = sync_channel(1);
        let busy = Arc::clone(&self.0);
        // What it logs is of the machine of whoever starts it.
        let span = tracing::Span::current();
        let begun = thread::Builder::new()
            .name("volcomp-files".to_owned())
            .spawn(move || {
                let result = span.in_scope(work);
                busy.store(false, Ordering::Release);
                // Whoever asked may have given up.
                let _ = tell.send(result);
            });
        if begun.is_err() {
            self.0.store(false, Ordering::Release);
        }
        begun.is_ok().then_some(told)
    }
}
