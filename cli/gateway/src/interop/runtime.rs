//! A thread of its own for each other system: one that is stuck holds up nothing else.

use std::thread::{self, JoinHandle};

use tokio::sync::oneshot;

use crate::error::GatewayError;

/// A thread that serves another system. It ends, with its sockets, when this is dropped.
pub(super) struct Serving {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Serving {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A task never blocks, so this waits for its next look; where it panicked there is nothing to wait for.
            let _ = thread.join();
        }
    }
}

/// Runs a task, which is made on a thread of its own and stays there, until what is returned is dropped.
pub(super) fn start<F: Future<Output = ()>>(
    name: &'static str,
    make: impl FnOnce() -> F + Send + 'static,
) -> Result<Serving, GatewayError> {
    let failed = |e| GatewayError::system(name, e);
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
        .map_err(failed)?;
    let (stop, stopped) = oneshot::channel::<()>();
    let span = tracing::Span::current();
    let thread = thread::Builder::new()
        .name(name.to_owned())
        .spawn(move || {
            let _entered = span.entered();
            runtime.block_on(async {
                tokio::select! {
                    () = make() => {}
                    _ = stopped => {}
                }
            });
            // A name that nobody resolves would hold it up.
            runtime.shutdown_background();
        })
        .map_err(failed)?;
    Ok(Serving {
        stop: Some(stop),
        thread: Some(thread),
    })
}
