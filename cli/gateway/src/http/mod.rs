//! The web server of the dashboard: pages, state, events, history, metrics and requests.

use std::net::SocketAddr;

use tokio::net::TcpListener;
use tracing::Instrument;

use crate::error::GatewayError;

mod access;
mod routes;

pub use access::{AccessControl, Denied, Holder, Role, Tokens};
pub use routes::{Dashboard, router};
pub use volcomp_web::{Tls, serve, tls};

/// Opens the socket of a dashboard.
///
/// # Errors
/// The address cannot be bound.
pub fn listen(address: SocketAddr) -> Result<std::net::TcpListener, GatewayError> {
    std::net::TcpListener::bind(address)
        .and_then(|listener| listener.set_nonblocking(true).map(|()| listener))
        .map_err(|e| match e.kind() {
            std::io::ErrorKind::AddrInUse => GatewayError::failed(format!(
                "dashboard {address}: another program listens there, such as another gateway: stop it, or state another address with --listen"
            )),
            _ => GatewayError::system(format!("dashboard {address}"), e),
        })
}

pub(crate) fn runtime<F>(
    listener: std::net::TcpListener,
    serve: impl FnOnce(TcpListener) -> F,
) -> Result<tokio::runtime::Runtime, GatewayError>
where
    F: Future<Output = ()> + Send + 'static,
{
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .max_blocking_threads(1)
        .thread_name("volcomp-http")
        .thread_stack_size(512 * 1024)
        .enable_io()
        .enable_time()
        .build()
        .map_err(|e| GatewayError::system("dashboard", e))?;
    let guard = runtime.enter();
    let listener =
        TcpListener::from_std(listener).map_err(|e| GatewayError::system("dashboard", e))?;
    drop(guard);
    runtime.spawn(serve(listener).in_current_span());
    Ok(runtime)
}
