//! One open session with the server of a control. It reads values and writes settings, each within a deadline.
//!
//! Closing a session always resets its TCP connection, so that undelivered data never reach the control later.
//! Otherwise a request written before a cable was unplugged could move an axis when the cable is plugged in again.

use std::{
    sync::Arc,
    time::{Duration, Instant},
};

use opcua::{
    client::{
        Client, ClientBuilder, ConnectionSource, IdentityToken, Session, UARequest,
        services::{Read, Write},
        transport::{
            Connector, RequestRecv, SecureChannelState, StreamConnection, StreamConnector,
            TcpTransport, TransportConfiguration,
        },
    },
    core::comms::tcp_codec::TcpCodec,
    crypto::SecurityPolicy,
    types::{
        AttributeId, DataValue, DecodingOptions, EndpointDescription, Error, MessageSecurityMode,
        NodeId, ReadValueId, StatusCode, TimestampsToReturn, Variant, WriteValue,
    },
};
use rustix::net::sockopt::set_socket_linger;
use tokio::{
    io::{ReadHalf, WriteHalf},
    net::TcpStream,
    runtime::{Builder, Runtime},
    task::JoinHandle,
};
use tokio_util::codec::FramedRead;

use crate::{
    config::{PORT, Security, Server},
    error::SinumerikError,
    opc_ua::trust,
    reading::Value,
};

/// Status codes by which a server rejects a write while the session stays usable.
const REFUSALS: [StatusCode; 6] = [
    StatusCode::BadUserAccessDenied,
    StatusCode::BadNotWritable,
    StatusCode::BadWriteNotSupported,
    StatusCode::BadTypeMismatch,
    StatusCode::BadOutOfRange,
    StatusCode::BadInvalidState,
];

/// Maximum size of a chunk, bytes. The library admits one chunk more than `MAX_CHUNKS`.
const MAX_CHUNK_BYTES: usize = 32 * 1024;
const MAX_CHUNKS: usize = 1;
/// Stack size of a thread that decodes what a control sends, bytes. The library (0.19) does not limit the nesting of
/// values, and takes up to 5.4 kB of stack for each byte of the largest message. With this stack, nested values cause
/// an error instead of the end of the process. Unused stack takes no memory.
pub(super) const DECODING_STACK_BYTES: usize = MAX_CHUNK_BYTES * (MAX_CHUNKS + 1) * 8 * 1024;

/// Creates a runtime with one thread, which has a stack of `DECODING_STACK_BYTES`.
pub(super) fn runtime() -> Result<Runtime, SinumerikError> {
    Builder::new_multi_thread()
        .worker_threads(1)
        .thread_stack_size(DECODING_STACK_BYTES)
        .enable_all()
        .build()
        .map_err(|error| SinumerikError::Client(error.to_string()))
}

/// An open session. Dropping it resets the connection and discards undelivered data.
pub(super) struct Link {
    session: Arc<Session>,
    events: JoinHandle<StatusCode>,
    namespace: u16,
    time_out: Duration,
}

pub(super) struct Answer {
    pub(super) values: Vec<DataValue>,
    /// Time of the response on the server's clock, in ticks of 100 ns.
    ticks: i64,
    pub(super) begun: Instant,
    pub(super) ended: Instant,
}

impl Link {
    /// Connects, logs in, and looks up the index of the server's namespace.
    pub(super) async fn open(server: &Server) -> Result<Self, SinumerikError> {
        // Connecting takes several exchanges, each within the timeout.
        let at_most = server.time_out * 4;
        let opened = tokio::time::timeout(at_most, Self::connect(server)).await;
        let mut link = opened.map_err(|_| SinumerikError::TimedOut(at_most))??;
        link.namespace = link.find_namespace(&server.namespace).await?;
        Ok(link)
    }

    async fn connect(server: &Server) -> Result<Self, SinumerikError> {
        let folder = server.pki.as_deref();
        let folder = folder.filter(|_| server.security != Security::None);
        if let Some(folder) = folder {
            trust::check_own(folder)?;
        }
        let client = client(server)?;
        let (policy, mode) = match server.security {
            Security::None => (SecurityPolicy::None, MessageSecurityMode::None),
            Security::Sign => (SecurityPolicy::Basic256Sha256, MessageSecurityMode::Sign),
            Security::SignAndEncrypt => {
                (SecurityPolicy::Basic256Sha256, MessageSecurityMode::SignAndEncrypt)
            }
        };
        let expected = EndpointDescription::from((server.url.as_str(), policy.to_str(), mode));
        let identity = match &server.user {
            None => IdentityToken::Anonymous,
            Some(user) => IdentityToken::UserName(user.name.clone(), user.password.clone().into()),
        };
        let connect = |error: opcua::types::Error| SinumerikError::Connect(error.to_string());
        // The discovery is a task of the runtime, so that its answer is decoded on the large stack.
        let url = server.url.clone();
        let discovery = tokio::spawn(async move {
            let endpoints = client.get_server_endpoints_from_url(url.as_str()).await;
            (client, endpoints)
        });
        let (client, endpoints) =
            discovery.await.map_err(|error| SinumerikError::Connect(error.to_string()))?;
        let endpoints = endpoints.map_err(connect)?;
        let endpoint = trust::endpoint(&endpoints, policy, mode)?;
        if let Some(folder) = folder {
            trust::admit(folder, endpoint)?;
        }
        let (session, events) = client
            .session_builder()
            .with_endpoints(endpoints)
            .with_connector(ResetOnClose {
                address: address(&server.url)?,
                time_out: server.time_out,
            })
            .connect_to_matching_endpoint(expected)
            .map_err(connect)?
            .user_identity_token(identity)
            .build(client.certificate_store().clone())
            .map_err(connect)?;
        // The library must not reopen a lost session, because old values could then be taken for new ones.
        session.disable_reconnects();
        let mut link =
            Self { session, events: events.spawn(), namespace: 0, time_out: server.time_out };
        tokio::select! {
            is_open = link.session.wait_for_connection() => {
                if is_open { Ok(link) } else { Err(SinumerikError::Connect("the session ended".to_owned())) }
            }
            ended = &mut link.events => {
                let reason = ended.map_or_else(|e| e.to_string(), |status| failure_text(status, server));
                Err(SinumerikError::Connect(reason))
            }
        }
    }

    async fn find_namespace(&self, expected: &str) -> Result<u16, SinumerikError> {
        const NAMESPACE_ARRAY: u32 = 2255;
        let answer = self.read_nodes(vec![NodeId::new(0, NAMESPACE_ARRAY)]).await?;
        let uris: Vec<String> = match answer.values.into_iter().next().and_then(|v| v.value) {
            Some(Variant::Array(array)) => array.values.iter().map(ToString::to_string).collect(),
            _ => {
                return Err(SinumerikError::Answer("a NamespaceArray that is not an array"));
            }
        };
        let index = uris.iter().position(|uri| uri == expected);
        let index = index.and_then(|index| u16::try_from(index).ok());
        index.ok_or_else(|| SinumerikError::NoNamespace {
            expected: expected.to_owned(),
            found: uris,
        })
    }

    fn id(&self, node: &str) -> NodeId {
        NodeId::new(self.namespace, node)
    }

    /// Reads nodes of the control from their source instead of the server's cache.
    pub(super) async fn read(&self, nodes: &[String]) -> Result<Answer, SinumerikError> {
        self.read_nodes(nodes.iter().map(|node| self.id(node)).collect()).await
    }

    async fn read_nodes(&self, nodes: Vec<NodeId>) -> Result<Answer, SinumerikError> {
        let count = nodes.len();
        let values = nodes.into_iter().map(|node| ReadValueId::new(node, AttributeId::Value));
        let read = Read::new(&self.session)
            .nodes_to_read(values.collect())
            .timestamps_to_return(TimestampsToReturn::Both)
            .max_age(0.0)
            .timeout(self.time_out);
        let begun = Instant::now();
        let response = self.within(read.send(self.session.channel())).await?;
        let values = response.results.unwrap_or_default();
        if values.len() != count {
            return Err(SinumerikError::Answer("another number of values than of nodes"));
        }
        Ok(Answer {
            values,
            ticks: response.response_header.timestamp.ticks(),
            begun,
            ended: Instant::now(),
        })
    }

    /// Writes nodes of the control. Returns the status of each node, or a single status if the server rejects the whole
    /// write.
    pub(super) async fn write(
        &self,
        values: impl Iterator<Item = (&String, Variant)>,
    ) -> Result<Vec<StatusCode>, SinumerikError> {
        let values = values.map(|(node, value)| {
            // The value has no status and timestamps, because many servers reject a write with them.
            let value = DataValue { value: Some(value), ..DataValue::null() };
            WriteValue::new(
                self.id(node),
                AttributeId::Value,
                opcua::types::NumericRange::None,
                value,
            )
        });
        let write =
            Write::new(&self.session).nodes_to_write(values.collect()).timeout(self.time_out);
        match self.answered(write.send(self.session.channel())).await? {
            Ok(response) => Ok(response.results.unwrap_or_default()),
            // The server rejected the write as a whole, but the session stays usable.
            Err(error) if REFUSALS.contains(&error.status()) => Ok(vec![error.status()]),
            Err(error) => Err(SinumerikError::Connect(error.to_string())),
        }
    }

    /// Waits for a response within the timeout. Errors: no response in time, or a rejected request.
    async fn within<T>(
        &self,
        request: impl Future<Output = Result<T, opcua::types::Error>>,
    ) -> Result<T, SinumerikError> {
        let answer = self.answered(request).await?;
        answer.map_err(|error| SinumerikError::Connect(error.to_string()))
    }

    /// Waits for the server's response within the timeout. The inner error is that of the response. Errors: no response
    /// in time.
    async fn answered<T>(
        &self,
        request: impl Future<Output = Result<T, opcua::types::Error>>,
    ) -> Result<Result<T, opcua::types::Error>, SinumerikError> {
        match tokio::time::timeout(self.time_out, request).await {
            Err(_) => Err(SinumerikError::TimedOut(self.time_out)),
            Ok(Err(error)) if error.status() == StatusCode::BadTimeout => {
                Err(SinumerikError::TimedOut(self.time_out))
            }
            Ok(answer) => Ok(answer),
        }
    }

    /// Closes the session properly, because a control admits only a few sessions.
    pub(super) async fn close(self) {
        // If the server does not respond, the session is dropped after the timeout.
        let _ = tokio::time::timeout(self.time_out, self.session.disconnect()).await;
    }
}

impl Drop for Link {
    fn drop(&mut self) {
        self.events.abort();
    }
}

impl Answer {
    pub(super) fn numbers(&self) -> Vec<Value> {
        self.values.iter().map(|value| self.number(value)).collect()
    }

    fn number(&self, value: &DataValue) -> Value {
        let age = value.source_timestamp.map(|source| {
            let ticks = self.ticks.saturating_sub(source.ticks());
            // A timestamp in the future counts as age 0.
            Duration::from_nanos(u64::try_from(ticks).unwrap_or(0).saturating_mul(100))
        });
        Value { number: number_of(value), age }
    }
}

/// Converts a value to a number, with 1 for true; `None` if the value is missing or not finite, or if its status is not
/// good.
pub(super) fn number_of(value: &DataValue) -> Option<f64> {
    let is_good = value.status.is_none_or(|status| status.is_good());
    match value.value.as_ref().filter(|_| is_good)? {
        Variant::Boolean(is_on) => Some(f64::from(u8::from(*is_on))),
        other => other.as_f64().filter(|number| number.is_finite()),
    }
}

/// Describes why no session could be opened, with advice for known causes.
fn failure_text(status: StatusCode, server: &Server) -> String {
    let what = match status {
        StatusCode::BadCertificateHostNameInvalid => {
            "the host of the URL is not in the server's certificate, expected a URL with one of its names, or a certificate with this host".to_owned()
        }
        StatusCode::BadSecurityChecksFailed
        | StatusCode::BadCertificateUntrusted
        | StatusCode::BadCertificateInvalid
        | StatusCode::BadCertificateUriInvalid
        | StatusCode::BadConnectionClosed
            if server.security != Security::None =>
        {
            format!(
                "the server rejects this client, expected its certificate ({}) among those that the server trusts",
                server.pki.as_deref().unwrap_or(std::path::Path::new("")).join(trust::OWN_CERTIFICATE).display()
            )
        }
        StatusCode::BadUserAccessDenied | StatusCode::BadIdentityTokenRejected | StatusCode::BadIdentityTokenInvalid => {
            "the server rejects the user, expected a valid name and password with the right to log in".to_owned()
        }
        _ => return status.to_string(),
    };
    format!("{status}: {what}")
}

fn client(server: &Server) -> Result<Client, SinumerikError> {
    let ms = |time: Duration| u32::try_from(time.as_millis()).unwrap_or(u32::MAX);
    let mut builder = ClientBuilder::new()
        .application_name("volcomp")
        .application_uri(trust::APPLICATION_URI)
        .product_uri("urn:volcomp")
        .session_name("volcomp")
        .session_retry_limit(0)
        .request_timeout(server.time_out)
        // The control keeps the session of a vanished gateway for this time. It admits only a few sessions.
        .session_timeout(ms(Duration::from_secs(10)))
        .keep_alive_interval(Duration::from_secs(2))
        // The clocks of controls are set by hand, so a difference of the clocks is ignored.
        .ignore_clock_skew(true)
        .max_message_size(MAX_CHUNK_BYTES)
        .max_chunk_size(MAX_CHUNK_BYTES)
        .max_chunk_count(MAX_CHUNKS)
        .trust_server_certs(server.security == Security::None)
        .verify_server_certs(server.security != Security::None);
    if let Some(pki) = &server.pki {
        builder = builder
            .pki_dir(pki)
            .certificate_path(trust::OWN_CERTIFICATE)
            .private_key_path(trust::OWN_KEY);
    }
    builder.client().map_err(|errors| SinumerikError::Client(errors.join("; ")))
}

fn address(url: &str) -> Result<String, SinumerikError> {
    let rest = url.strip_prefix("opc.tcp://").unwrap_or(url);
    let authority = rest.split('/').next().unwrap_or_default();
    let has_port = authority.rsplit_once(':').is_some_and(|(host, port)| {
        !host.is_empty() && port.parse::<u16>().is_ok() && !port.contains(']')
    });
    match (authority.is_empty(), has_port) {
        (true, _) => {
            Err(SinumerikError::Client(format!("found {url}, expected opc.tcp://HOST:{PORT}")))
        }
        (false, true) => Ok(authority.to_owned()),
        (false, false) => Ok(format!("{authority}:{PORT}")),
    }
}

struct ResetOnClose {
    address: String,
    /// Maximum time for which sent data may stay unacknowledged. After it the connection ends.
    time_out: Duration,
}

struct ResetOnCloseConnector {
    address: String,
    time_out: Duration,
    endpoint_url: String,
}

impl ConnectionSource for ResetOnClose {
    type Builder = ResetOnCloseConnector;

    fn get_connector(
        &self,
        endpoint: &EndpointDescription,
    ) -> Result<ResetOnCloseConnector, Error> {
        Ok(ResetOnCloseConnector {
            address: self.address.clone(),
            time_out: self.time_out,
            endpoint_url: endpoint.endpoint_url.as_ref().to_owned(),
        })
    }
}

impl Connector for ResetOnCloseConnector {
    type Transport = TcpTransport;

    async fn connect(
        &self,
        channel: Arc<SecureChannelState>,
        outgoing: RequestRecv,
        config: TransportConfiguration,
    ) -> Result<TcpTransport, Error> {
        let (address, time_out) = (self.address.clone(), self.time_out);
        let open = move |url: String, decoding: DecodingOptions| {
            open(address.clone(), time_out, url, decoding)
        };
        StreamConnector::new(open, self.endpoint_url.clone())
            .connect(channel, outgoing, config)
            .await
    }

    fn default_endpoint(&self) -> EndpointDescription {
        EndpointDescription::from(self.endpoint_url.as_str())
    }
}

type Halves = StreamConnection<ReadHalf<TcpStream>, WriteHalf<TcpStream>>;

async fn open(
    address: String,
    time_out: Duration,
    url: String,
    decoding: DecodingOptions,
) -> Result<Halves, Error> {
    let failed = |error: std::io::Error| {
        Error::new(StatusCode::BadCommunicationError, format!("{address}: {error}"))
    };
    let stream = TcpStream::connect(&address).await.map_err(failed)?;
    stream.set_nodelay(true).map_err(failed)?;
    set_socket_linger(&stream, Some(Duration::ZERO)).map_err(|e| failed(e.into()))?;
    #[cfg(target_os = "linux")]
    {
        let ms = u32::try_from(time_out.as_millis()).unwrap_or(u32::MAX).max(1);
        // If the kernel does not support this option, only the deadlines of requests apply.
        let _ = rustix::net::sockopt::set_tcp_user_timeout(&stream, ms);
    }
    #[cfg(not(target_os = "linux"))]
    let _ = time_out;
    let (reader, writer) = tokio::io::split(stream);
    let reader = FramedRead::new(reader, TcpCodec::new(decoding));
    Ok(StreamConnection::new(reader, writer, url))
}
