//! An OPC UA server: clients browse and read the state of the gateway. No node can be written or called.
//!
//! The library's server accepts an unlimited number of connections. It therefore listens on an internal address, and
//! clients connect through a proxy that limits their number.

use std::{
    io,
    net::{Ipv4Addr, SocketAddr, TcpListener},
    path::PathBuf,
    sync::atomic::Ordering,
    time::Duration,
};

use opcua::{
    server::{
        ANONYMOUS_USER_TOKEN_ID, Server, ServerBuilder, ServerEndpoint, ServerHandle,
        diagnostics::NamespaceMetadata, node_manager::memory::simple_node_manager,
    },
    types::BuildInfo,
};
use tracing::subscriber::{NoSubscriber, set_default};

use super::{Serving, quantities::Shape, start};
use crate::{config::OpcUaConfig, error::GatewayError, published::Published};

mod gate;
mod nodes;
mod values;

/// Namespace of the nodes.
const NAMESPACE: &str = "urn:volcomp:gateway";
/// Timeout for a client's hello message, s.
const HELLO_WITHIN_S: u32 = 5;
/// Polling interval of the proxy until the server is ready.
const LOOK: Duration = Duration::from_millis(5);

/// The bound sockets; they do not serve clients yet.
pub(super) struct Bound {
    /// Socket for clients.
    outer: TcpListener,
    /// Socket of the library's server.
    inner: TcpListener,
    listen: SocketAddr,
}

impl Bound {
    pub(super) fn new(config: &OpcUaConfig) -> Result<Self, GatewayError> {
        let failed = |e| failed(config.listen, e);
        let bound = |address: SocketAddr| {
            let listener = TcpListener::bind(address)?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        };
        let outer = bound(config.listen).map_err(failed)?;
        // A random loopback address, which other computers cannot reach and local programs do not find by trying.
        let [a, b, c]: [u8; 3] = rand::random();
        let inner = SocketAddr::from((Ipv4Addr::new(127, a, b, c.clamp(2, 254)), 0));
        Ok(Self {
            listen: outer.local_addr().map_err(failed)?,
            outer,
            inner: bound(inner).map_err(failed)?,
        })
    }

    pub(super) fn serve(
        self,
        shape: &Shape,
        published: &Published,
    ) -> Result<Serving, GatewayError> {
        let (shape, published) = (shape.clone(), published.clone());
        let own = tracing::dispatcher::get_default(Clone::clone);
        start("volcomp-opcua", move || async move {
            // The library would log every connection.
            let silent = set_default(NoSubscriber::default());
            let ended = self.run(&shape, &published).await;
            drop(silent);
            if let Err(e) = ended {
                tracing::dispatcher::with_default(&own, || tracing::error!("OPC UA: {e}"));
            }
        })
    }

    /// Serves until it is dropped or an error occurs.
    async fn run(self, shape: &Shape, published: &Published) -> Result<(), String> {
        // The server spawns tasks, so it is created on the runtime that executes them.
        let (server, handle) = server(self.listen, shape)?;
        nodes::fill(&handle, shape, published)?;
        let inner = self.inner.local_addr().map_err(|e| e.to_string())?;
        let [outer, listener] = [self.outer, self.inner].map(tokio::net::TcpListener::from_std);
        let outer = outer.map_err(|e| e.to_string())?;
        let gate = async {
            // Clients must be given the address of the proxy, but the server sets its own when it starts.
            let port = &handle.info().port;
            while port.load(Ordering::Relaxed) == 0 {
                tokio::time::sleep(LOOK).await;
            }
            port.store(self.listen.port(), Ordering::Relaxed);
            gate::serve(outer, inner).await
        };
        tokio::select! {
            ended = server.run_with(listener.map_err(|e| e.to_string())?) => ended,
            never = gate => match never {},
        }
    }
}

fn failed(listen: SocketAddr, source: io::Error) -> GatewayError {
    GatewayError::system(format!("opc_ua {listen}"), source)
}

/// Builds the server: anonymous clients, no encryption, low limits.
fn server(listen: SocketAddr, shape: &Shape) -> Result<(Server, ServerHandle), String> {
    // The library relies on the working directory: report here if there is none.
    std::env::current_dir().map_err(|e| format!("the working directory: {e}"))?;
    let metadata = NamespaceMetadata {
        namespace_uri: NAMESPACE.to_owned(),
        ..Default::default()
    };
    let endpoint = ServerEndpoint::new_none("/", &[ANONYMOUS_USER_TOKEN_ID.to_owned()]);
    let mut builder = ServerBuilder::new()
        .application_name("volcomp-gateway")
        .application_uri(format!(
            "{NAMESPACE}:{}",
            super::quantities::key_of(&shape.machine)
        ))
        .product_uri(NAMESPACE)
        .build_info(BuildInfo {
            product_uri: NAMESPACE.into(),
            product_name: "volcomp-gateway".into(),
            software_version: env!("CARGO_PKG_VERSION").into(),
            ..Default::default()
        })
        .host(host(listen))
        .port(listen.port())
        .add_endpoint("none", endpoint)
        .discovery_urls(vec!["/".to_owned()])
        .hello_timeout(HELLO_WITHIN_S)
        // No certificates are used; this path prevents the library from creating a folder.
        .pki_dir(PathBuf::from("/dev/null/none"))
        .with_node_manager(simple_node_manager(metadata, "volcomp"));
    let limits = builder.limits_mut();
    limits.max_sessions = 2 * gate::MAX_CLIENTS;
    limits.subscriptions.max_subscriptions_per_session = 8;
    limits.subscriptions.max_monitored_item_queue_size = 10;
    limits.subscriptions.max_queued_notifications = 10;
    builder.build()
}

/// Host in the addresses given to clients.
fn host(listen: SocketAddr) -> String {
    match listen {
        listen if listen.ip().is_unspecified() => {
            let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_default();
            match name.trim() {
                "" => "localhost".to_owned(),
                name => name.to_owned(),
            }
        }
        SocketAddr::V4(listen) => listen.ip().to_string(),
        SocketAddr::V6(listen) => format!("[{}]", listen.ip()),
    }
}
