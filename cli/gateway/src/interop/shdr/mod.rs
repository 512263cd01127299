//! An MTConnect adapter: agents read the gateway over TCP as SHDR lines.

use std::{net::TcpListener, sync::Arc};

use super::{Serving, quantities::Shape, start};
use crate::{config::ShdrConfig, error::GatewayError, published::Published};

mod device;
pub mod lines;
mod server;

pub use device::device;
use lines::Items;

/// The bound socket; clients are served once the service runs.
pub(super) struct Bound(TcpListener);

impl Bound {
    pub(super) fn new(config: &ShdrConfig) -> Result<Self, GatewayError> {
        // A small send buffer limits the memory per client and detects early that a client does not read.
        let listener = TcpListener::bind(config.listen).and_then(|listener| {
            rustix::net::sockopt::set_socket_send_buffer_size(&listener, 64 * 1024)?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        });
        let failed = |e| GatewayError::system(format!("shdr {}", config.listen), e);
        Ok(Self(listener.map_err(failed)?))
    }

    pub(super) fn serve(
        self,
        shape: &Shape,
        published: Published,
    ) -> Result<Serving, GatewayError> {
        let items = Arc::new(Items::of(shape));
        start("volcomp-shdr", move || async move {
            match tokio::net::TcpListener::from_std(self.0) {
                Ok(listener) => server::serve(listener, items, published).await,
                Err(e) => tracing::error!("SHDR: {e}"),
            }
        })
    }
}
