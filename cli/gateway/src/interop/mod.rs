//! Other systems that read the gateway, each over its own way and on a thread of its own. Nothing that comes over these ways
//! commands anything.
#![cfg_attr(
    not(any(feature = "shdr", feature = "opc-ua-server")),
    allow(unused_variables, reason = "without any way there is nothing to do")
)]

#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
use std::thread::{self, JoinHandle};

#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
use tokio::sync::oneshot;

use crate::{config::Config, error::GatewayError, published::Published};

pub mod alarms;
#[cfg(feature = "opc-ua-server")]
mod opc_ua;
pub mod quantities;
#[cfg(feature = "shdr")]
pub mod shdr;

use quantities::Shape;

/// The ways that are configured, with their sockets and files; nobody is served yet.
pub struct Interop {
    #[cfg(feature = "shdr")]
    shdr: Option<shdr::Bound>,
    #[cfg(feature = "opc-ua-server")]
    opc_ua: Option<opc_ua::Bound>,
}

impl Interop {
    /// Opens sockets and reads files.
    ///
    /// # Errors
    /// An address at which this computer does not let it listen, or a file that cannot be used.
    pub fn open(config: &Config) -> Result<Self, GatewayError> {
        Ok(Self {
            #[cfg(feature = "shdr")]
            shdr: config.shdr.as_ref().map(shdr::Bound::new).transpose()?,
            #[cfg(feature = "opc-ua-server")]
            opc_ua: (config.opc_ua.as_ref())
                .map(opc_ua::Bound::new)
                .transpose()?,
        })
    }

    /// Serves until what is returned is dropped.
    ///
    /// # Errors
    /// A thread that cannot be started.
    pub fn serve(self, shape: &Shape, published: &Published) -> Result<Served, GatewayError> {
        Ok(Served {
            #[cfg(feature = "shdr")]
            _shdr: (self.shdr)
                .map(|shdr| shdr.serve(shape, published.clone()))
                .transpose()?,
            #[cfg(feature = "opc-ua-server")]
            _opc_ua: (self.opc_ua)
                .map(|opc_ua| opc_ua.serve(shape, published))
                .transpose()?,
        })
    }
}

/// The threads of the ways. They end, and their sockets close, when this is dropped.
pub struct Served {
    #[cfg(feature = "shdr")]
    _shdr: Option<Serving>,
    #[cfg(feature = "opc-ua-server")]
    _opc_ua: Option<Serving>,
}

/// A thread that serves another system. It ends, with its sockets, when this is dropped.
#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
struct Serving {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
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
#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
fn start<F: Future<Output = ()>>(
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
