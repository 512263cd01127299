//! Slow work and work that may wait for a disk, executed one task at a time on a separate thread.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

#[derive(Default)]
pub(super) struct Worker(Arc<AtomicBool>);

impl Worker {
    /// Waits at most `timeout` until the task is complete. Returns whether it is.
    pub(super) fn settle(&self, timeout: Duration) -> bool {
        let end = Instant::now() + timeout;
        while self.0.load(Ordering::Acquire) {
            if Instant::now() > end {
                return false;
            }
            thread::sleep(Duration::from_micros(100));
        }
        true
    }

    /// Starts a task; the receiver yields its result. `None`: the last task is still running, or no thread can be
    /// created.
    pub(super) fn begin<T: Send + 'static>(
        &mut self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Option<Receiver<T>> {
        if self.0.swap(true, Ordering::AcqRel) {
            return None;
        }
        let (tell, result) = sync_channel(1);
        let busy = Arc::clone(&self.0);
        // The thread logs under the span of the machine that starts it.
        let span = tracing::Span::current();
        let begun = thread::Builder::new()
            .name("volcomp-files".to_owned())
            .spawn(move || {
                let result = span.in_scope(work);
                busy.store(false, Ordering::Release);
                // The receiver may have been dropped.
                let _ = tell.send(result);
            });
        if begun.is_err() {
            self.0.store(false, Ordering::Release);
        }
        begun.is_ok().then_some(result)
    }
}
