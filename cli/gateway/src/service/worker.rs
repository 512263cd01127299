//! Slow work, and work that may wait for a disk. A separate thread executes one task at a time.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
        mpsc::{Receiver, sync_channel},
    },
    thread,
    time::{Duration, Instant},
};

#[derive(Default)]
pub(super) struct Worker {
    /// Cleared before the result is sent, so that the receiver of the result can begin the next task.
    busy: Arc<AtomicBool>,
    /// Number of tasks whose result has not been sent.
    open: Arc<AtomicUsize>,
}

impl Worker {
    /// Waits at most `timeout` until the results of all tasks can be received. Returns false after the timeout.
    pub(super) fn settle(&self, timeout: Duration) -> bool {
        let end = Instant::now() + timeout;
        while self.open.load(Ordering::Acquire) > 0 {
            if Instant::now() > end {
                return false;
            }
            thread::sleep(Duration::from_micros(100));
        }
        true
    }

    /// Starts a task and returns the receiver of its result. `None`: the last task is still running, or no thread can
    /// be created.
    pub(super) fn begin<T: Send + 'static>(
        &mut self,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Option<Receiver<T>> {
        if self.busy.swap(true, Ordering::AcqRel) {
            return None;
        }
        let (tell, result) = sync_channel(1);
        let (busy, open) = (Arc::clone(&self.busy), Arc::clone(&self.open));
        open.fetch_add(1, Ordering::AcqRel);
        // The thread logs under the span of the machine that starts it.
        let span = tracing::Span::current();
        let begun = thread::Builder::new().name("volcomp-files".to_owned()).spawn(move || {
            let result = span.in_scope(work);
            busy.store(false, Ordering::Release);
            // The receiver may have been dropped.
            let _ = tell.send(result);
            open.fetch_sub(1, Ordering::AcqRel);
        });
        if begun.is_err() {
            self.busy.store(false, Ordering::Release);
            self.open.fetch_sub(1, Ordering::AcqRel);
        }
        begun.is_ok().then_some(result)
    }
}
