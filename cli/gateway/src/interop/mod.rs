//! Read-only interfaces for other systems, each on a separate thread. They accept no commands.
#![cfg_attr(
    not(any(feature = "shdr", feature = "opc-ua-server")),
    allow(unused_variables, reason = "without any way there is nothing to do")
)]

#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
use std::thread::{self, JoinHandle};

#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
use tokio::sync::oneshot;

use crate::{config::Config, error::GatewayError, published::Published};

#[cfg(feature = "opc-ua-server")]
mod opc_ua;
pub mod quantities;
#[cfg(feature = "shdr")]
pub mod shdr;

use quantities::Shape;

/// The configured interfaces with open sockets. [`serve`](Self::serve) accepts clients.
pub struct Interop {
    #[cfg(feature = "shdr")]
    shdr: Option<shdr::Bound>,
    #[cfg(feature = "opc-ua-server")]
    opc_ua: Option<opc_ua::Bound>,
}

impl Interop {
    /// Opens the sockets.
    ///
    /// # Errors
    /// An address cannot be bound.
    pub fn open(config: &Config) -> Result<Self, GatewayError> {
        Ok(Self {
            #[cfg(feature = "shdr")]
            shdr: config.shdr.as_ref().map(shdr::Bound::new).transpose()?,
            #[cfg(feature = "opc-ua-server")]
            opc_ua: (config.opc_ua.as_ref()).map(opc_ua::Bound::new).transpose()?,
        })
    }

    /// Serves until the returned value is dropped.
    ///
    /// # Errors
    /// A thread cannot be started.
    pub fn serve(
        self,
        shape: &Shape,
        published: &Published,
    ) -> Result<RunningInterfaces, GatewayError> {
        Ok(RunningInterfaces {
            #[cfg(feature = "shdr")]
            _shdr: (self.shdr).map(|shdr| shdr.serve(shape, published.clone())).transpose()?,
            #[cfg(feature = "opc-ua-server")]
            _opc_ua: (self.opc_ua).map(|opc_ua| opc_ua.serve(shape, published)).transpose()?,
        })
    }
}

/// The threads of the interfaces. Dropping this value ends them and closes their sockets.
pub struct RunningInterfaces {
    #[cfg(feature = "shdr")]
    _shdr: Option<InterfaceThread>,
    #[cfg(feature = "opc-ua-server")]
    _opc_ua: Option<InterfaceThread>,
}

/// A thread that serves one interface. Dropping it ends the thread and closes its sockets.
#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
struct InterfaceThread {
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
impl Drop for InterfaceThread {
    fn drop(&mut self) {
        drop(self.stop.take());
        if let Some(thread) = self.thread.take() {
            // A task never blocks, so this waits only for its next poll. A panic of the thread needs no handling here.
            let _ = thread.join();
        }
    }
}

/// Maximum size of an OPC UA message, bytes. A message has one chunk.
#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
const MAX_MESSAGE_BYTES: usize = 32 * 1024;
/// Stack size of a thread, bytes. The OPC UA library (0.19) does not limit the nesting depth of received values and
/// uses up to 5.4 kB of stack for each byte of a message. With this stack a deeply nested value is an error instead of
/// the end of the process. Unused stack takes no memory.
#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
const STACK_BYTES: usize = MAX_MESSAGE_BYTES * 8 * 1024;

#[cfg(any(feature = "shdr", feature = "opc-ua-server"))]
fn start<F: Future<Output = ()>>(
    name: &'static str,
    make: impl FnOnce() -> F + Send + 'static,
) -> Result<InterfaceThread, GatewayError> {
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
        .stack_size(STACK_BYTES)
        .spawn(move || {
            let _entered = span.entered();
            runtime.block_on(async {
                tokio::select! {
                    () = make() => {}
                    _ = stopped => {}
                }
            });
            // Do not wait for a pending name resolution.
            runtime.shutdown_background();
        })
        .map_err(failed)?;
    Ok(InterfaceThread { stop: Some(stop), thread: Some(thread) })
}
