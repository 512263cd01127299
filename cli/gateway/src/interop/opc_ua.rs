//! An OPC UA server: clients browse and read the state of the gateway. No node can be written or called.
//!
//! The library's server accepts an unlimited number of connections. The server therefore listens on an internal
//! address, and clients connect through a proxy that limits their number.

use std::{
    collections::BTreeSet,
    convert::Infallible,
    io,
    net::{Ipv4Addr, SocketAddr},
    path::PathBuf,
    sync::{Arc, atomic::Ordering},
    time::{Duration, SystemTime},
};

use opcua::{
    nodes::VariableBuilder,
    server::{
        ANONYMOUS_USER_TOKEN_ID, Server, ServerBuilder, ServerEndpoint, ServerHandle,
        address_space::AddressSpace,
        constants::MAX_SESSION_TIMEOUT,
        diagnostics::NamespaceMetadata,
        node_manager::memory::{SimpleNodeManager, simple_node_manager},
    },
    types::{
        BuildInfo, DataTypeId, DataValue, DateTime, NodeId, NumericRange, ObjectId, QualifiedName,
        StatusCode, TimestampsToReturn, VariableTypeId, Variant,
    },
};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    sync::Semaphore,
    time::{Instant, sleep, sleep_until, timeout, timeout_at},
};
use tracing::subscriber::{NoSubscriber, set_default};

use crate::{
    config::OpcUaConfig,
    error::GatewayError,
    interop::{
        InterfaceThread,
        quantities::{Kind, Quality, Quantity, Reading, Shape, Value, quantities},
        start,
    },
    published::Published,
};

const NAMESPACE: &str = "urn:volcomp:gateway";
const HELLO_TIMEOUT_S: u32 = 5;
/// Polling interval of the proxy until the server is ready.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

pub(super) struct Bound {
    outer: std::net::TcpListener,
    inner: std::net::TcpListener,
    listen: SocketAddr,
}

impl Bound {
    pub(super) fn new(config: &OpcUaConfig) -> Result<Self, GatewayError> {
        let failed = |e| failed(config.listen, e);
        let bound = |address: SocketAddr| {
            let listener = std::net::TcpListener::bind(address)?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        };
        let outer = bound(config.listen).map_err(failed)?;
        // A random loopback address: other computers cannot reach it, and local programs cannot find it by trial.
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
    ) -> Result<InterfaceThread, GatewayError> {
        let (shape, published) = (shape.clone(), published.clone());
        let own = tracing::dispatcher::get_default(Clone::clone);
        start("volcomp-opcua", move || async move {
            // Without this subscriber the library would log every connection.
            let silent = set_default(NoSubscriber::default());
            let ended = self.run(&shape, &published).await;
            drop(silent);
            if let Err(e) = ended {
                tracing::dispatcher::with_default(&own, || tracing::error!("OPC UA: {e}"));
            }
        })
    }

    /// Serves until this future is dropped or an error occurs.
    async fn run(self, shape: &Shape, published: &Published) -> Result<(), String> {
        // The server spawns tasks on the current runtime, so it is created here.
        let (server, handle) = server(self.listen, shape)?;
        fill(&handle, shape, published)?;
        let inner = self.inner.local_addr().map_err(|e| e.to_string())?;
        let [outer, listener] = [self.outer, self.inner].map(TcpListener::from_std);
        let outer = outer.map_err(|e| e.to_string())?;
        let proxy = async {
            // The server sets its own port when it starts, but clients must receive the port of the proxy.
            let port = &handle.info().port;
            while port.load(Ordering::Relaxed) == 0 {
                tokio::time::sleep(POLL_INTERVAL).await;
            }
            port.store(self.listen.port(), Ordering::Relaxed);
            serve(outer, inner).await
        };
        tokio::select! {
            ended = server.run_with(listener.map_err(|e| e.to_string())?) => ended,
            never = proxy => match never {},
        }
    }
}

fn failed(listen: SocketAddr, source: io::Error) -> GatewayError {
    GatewayError::system(format!("opc_ua {listen}"), source)
}

/// Builds the server: anonymous clients, no encryption, low limits.
fn server(listen: SocketAddr, shape: &Shape) -> Result<(Server, ServerHandle), String> {
    // The library needs a working directory, so report a missing one here.
    std::env::current_dir().map_err(|e| format!("the working directory: {e}"))?;
    let metadata = NamespaceMetadata { namespace_uri: NAMESPACE.to_owned(), ..Default::default() };
    let endpoint = ServerEndpoint::new_none("/", &[ANONYMOUS_USER_TOKEN_ID.to_owned()]);
    let mut builder = ServerBuilder::new()
        .application_name("volcomp-gateway")
        .application_uri(format!("{NAMESPACE}:{}", super::quantities::key_of(&shape.machine)))
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
        .hello_timeout(HELLO_TIMEOUT_S)
        // No certificates are used. This path prevents the library from creating a folder.
        .pki_dir(PathBuf::from("/dev/null/none"))
        .with_node_manager(simple_node_manager(metadata, "volcomp"));
    let limits = builder.limits_mut();
    (limits.max_message_size, limits.max_chunk_count) = (super::MAX_MESSAGE_BYTES, 1);
    limits.max_sessions = 2 * MAX_CLIENTS;
    limits.subscriptions.max_subscriptions_per_session = 8;
    limits.subscriptions.max_monitored_item_queue_size = 10;
    limits.subscriptions.max_queued_notifications = 10;
    builder.build()
}

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

/// Maximum number of clients. A further client is disconnected, so that existing connections remain.
const MAX_CLIENTS: usize = 16;
/// Clients that send nothing for this long are disconnected. The library ends their sessions after the same time.
const IDLE_TIMEOUT: Duration = Duration::from_millis(MAX_SESSION_TIMEOUT);
/// Clients that do not read for this long are disconnected.
const WRITE_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum size of one read from a client, bytes; with one read per [`READ_INTERVAL`] the input rate is at most 1.6 MB/s.
const MAX_READ_BYTES: usize = 8 * 1024;
const READ_INTERVAL: Duration = Duration::from_millis(5);
/// Retry interval when `accept` fails because no file descriptors are left.
const RETRY_INTERVAL: Duration = Duration::from_millis(100);

/// Proxy in front of the server at `inner`: limits the number of clients and their input rate, and disconnects clients
/// that send nothing or do not read.
async fn serve(listener: TcpListener, inner: SocketAddr) -> Infallible {
    let places = Arc::new(Semaphore::new(MAX_CLIENTS));
    loop {
        let Ok((client, _)) = listener.accept().await else {
            sleep(RETRY_INTERVAL).await;
            continue;
        };
        // Without a permit the client is dropped, which closes its connection.
        if let Ok(place) = Arc::clone(&places).try_acquire_owned() {
            tokio::spawn(async move {
                // The error only reports which side closed the connection.
                let _ = pass(client, inner).await;
                drop(place);
            });
        }
    }
}

/// Forwards both directions until one side closes, or until a write takes longer than `WRITE_TIMEOUT`. While a client
/// does not read its responses, nothing more is read from it, so that responses do not pile up.
async fn pass(mut client: TcpStream, inner: SocketAddr) -> io::Result<()> {
    let mut server = TcpStream::connect(inner).await?;
    client.set_nodelay(true)?;
    server.set_nodelay(true)?;
    let [mut from_client, mut from_server] = [(); 2].map(|()| vec![0; MAX_READ_BYTES]);
    let mut heard = Instant::now();
    loop {
        let received = async {
            sleep_until(heard + READ_INTERVAL).await;
            client.read(&mut from_client).await
        };
        let (to, bytes) = tokio::select! {
            read = timeout_at(heard + IDLE_TIMEOUT, received) => {
                heard = Instant::now();
                (&mut server, &from_client[..read??])
            }
            read = server.read(&mut from_server) => (&mut client, &from_server[..read?]),
        };
        if bytes.is_empty() {
            return Ok(());
        }
        timeout(WRITE_TIMEOUT, to.write_all(bytes)).await??;
    }
}

/// The root folder and prefix of folder identifiers.
const ROOT: &str = "volcomp";

/// Creates the nodes. Each node reads the latest state on access.
///
/// # Errors
/// The server was built without a manager for these nodes.
fn fill(handle: &ServerHandle, shape: &Shape, published: &Published) -> Result<(), String> {
    let managers = handle.node_managers();
    let manager = managers.get_of_type::<SimpleNodeManager>();
    let namespace = handle.get_namespace_index(NAMESPACE);
    let (manager, namespace) = (manager.zip(namespace))
        .ok_or_else(|| format!("the server has no namespace {NAMESPACE}"))?;
    let mut space = manager.address_space().write();
    let mut folders = Folders { namespace, made: BTreeSet::new() };
    for quantity in quantities(shape) {
        let folder = folders.of(&mut space, &quantity.folder());
        let node = NodeId::new(namespace, quantity.key.clone());
        let name = quantity.name();
        VariableBuilder::new(&node, QualifiedName::new(namespace, name.clone()), name)
            .description(description(&quantity))
            .data_type(data_type(quantity.kind))
            .has_type_definition(VariableTypeId::BaseDataVariableType)
            .component_of(folder)
            .insert(&mut *space);
        let published = published.clone();
        manager.inner().add_read_callback(node, move |range, stamps, _| {
            if !matches!(range, NumericRange::None) {
                return Err(StatusCode::BadIndexRangeNoData);
            }
            let reading = quantity.read(&published.latest());
            Ok(value(reading, SystemTime::now(), stamps))
        });
    }
    Ok(())
}

struct Folders {
    namespace: u16,
    made: BTreeSet<String>,
}

impl Folders {
    fn of(&mut self, space: &mut AddressSpace, path: &[&str]) -> NodeId {
        let mut above = NodeId::from(ObjectId::ObjectsFolder);
        let mut whole = String::new();
        for name in std::iter::once(&ROOT).chain(path) {
            if !whole.is_empty() {
                whole.push('/');
            }
            whole.push_str(name);
            let node = NodeId::new(self.namespace, whole.clone());
            if self.made.insert(whole.clone()) {
                space.add_folder(&node, QualifiedName::new(self.namespace, *name), *name, &above);
            }
            above = node;
        }
        above
    }
}

fn data_type(kind: Kind) -> DataTypeId {
    match kind {
        Kind::Number(_) => DataTypeId::Double,
        Kind::Whole | Kind::Count => DataTypeId::UInt64,
        Kind::Truth => DataTypeId::Boolean,
        Kind::Text => DataTypeId::String,
    }
}

fn description(quantity: &Quantity) -> String {
    match quantity.kind {
        Kind::Number(unit) => format!("{}, {}", quantity.help, unit.symbol()),
        _ => quantity.help.to_owned(),
    }
}

/// Offset between the epochs of OPC UA (1601) and Unix (1970), in steps of 100 ns.
const UNIX_EPOCH_TICKS: i64 = 116_444_736_000_000_000;

fn value(reading: Reading, now: SystemTime, stamps: TimestampsToReturn) -> DataValue {
    let age = Duration::try_from_secs_f64(reading.age_ms * 1e-3).unwrap_or_default();
    let source = now.checked_sub(age).unwrap_or(now);
    let asks = |own| stamps == own || stamps == TimestampsToReturn::Both;
    DataValue {
        value: reading.value.map(|value| match value {
            Value::Number(number) => Variant::Double(number),
            Value::Whole(number) => Variant::UInt64(number),
            Value::Truth(yes) => Variant::Boolean(yes),
            Value::Text(text) => Variant::String(text.into()),
        }),
        status: Some(match reading.quality {
            Quality::Good => StatusCode::Good,
            Quality::Doubtful => StatusCode::Uncertain,
            Quality::Stale => StatusCode::UncertainLastUsableValue,
            Quality::Unknown => StatusCode::BadNoCommunication,
        }),
        source_timestamp: asks(TimestampsToReturn::Source).then(|| time(source)),
        server_timestamp: asks(TimestampsToReturn::Server).then(|| time(now)),
        ..DataValue::default()
    }
}

fn time(at: SystemTime) -> DateTime {
    let since = at.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default();
    let ticks = i64::try_from(since.as_nanos() / 100).unwrap_or(i64::MAX);
    DateTime::from(ticks.saturating_add(UNIX_EPOCH_TICKS))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test(start_paused = true)]
    async fn a_client_that_sends_nothing_is_disconnected() {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let mut client =
            TcpStream::connect(listener.local_addr().expect("bound")).await.expect("it listens");
        let (outer, _) = listener.accept().await.expect("a client");
        let passing = pass(outer, listener.local_addr().expect("bound"));
        let ended = timeout(10 * IDLE_TIMEOUT, passing).await.expect("it ends");
        assert_eq!(ended.expect_err("idle").kind(), io::ErrorKind::TimedOut);
        assert_eq!(client.read(&mut [0]).await.expect("closed"), 0);
    }

    #[test]
    fn only_current_values_are_good() {
        let now = SystemTime::UNIX_EPOCH + Duration::from_millis(1_700_000_000_500);
        let converted = |quality, value: Option<f64>| {
            let reading = Reading { value: value.map(Value::Number), quality, age_ms: 1500.0 };
            super::value(reading, now, TimestampsToReturn::Both)
        };
        for (quality, expected) in [
            (Quality::Good, StatusCode::Good),
            (Quality::Doubtful, StatusCode::Uncertain),
            (Quality::Stale, StatusCode::UncertainLastUsableValue),
        ] {
            let found = converted(quality, Some(2.5));
            assert_eq!(found.value, Some(Variant::Double(2.5)));
            assert_eq!(found.status, Some(expected));
            let times = [found.source_timestamp, found.server_timestamp];
            let times = times.map(|time| time.expect("requested").as_chrono().timestamp_millis());
            assert_eq!(times, [1_699_999_999_000, 1_700_000_000_500]);
        }
        let nothing = converted(Quality::Unknown, None);
        assert_eq!(nothing.value, None);
        assert!(nothing.status.expect("a status").is_bad());
    }
}
