//! Client side of an HTTP exchange, with or without TLS.

use std::{
    io::{ErrorKind, Read, Write},
    net::{SocketAddr, TcpStream},
    sync::Arc,
    time::{Duration, Instant},
};

use tokio_rustls::rustls::{
    self, ClientConfig, ClientConnection, RootCertStore, StreamOwned,
    crypto::ring,
    pki_types::{CertificateDer, ServerName},
};

use crate::CertificateError;

const MAX_RESPONSE_BYTES: u64 = 4 * 1024 * 1024;

/// A connection with one deadline for all reads and writes together. A peer that sends single bytes cannot extend the
/// deadline.
pub struct Connection {
    stream: TcpStream,
    deadline: Instant,
}

impl Connection {
    /// Connects to a server. The deadline for connecting and for all later reads and writes is `within` from now.
    ///
    /// # Errors
    /// The connection is not established within this time.
    pub fn open(address: &SocketAddr, within: Duration) -> std::io::Result<Self> {
        let deadline = Instant::now() + within;
        let stream = TcpStream::connect_timeout(address, within)?;
        Ok(Self { stream, deadline })
    }

    fn remaining(&self) -> std::io::Result<Option<Duration>> {
        let remaining = self.deadline.saturating_duration_since(Instant::now());
        if remaining.is_zero() {
            return Err(ErrorKind::TimedOut.into());
        }
        Ok(Some(remaining))
    }
}

impl Read for Connection {
    fn read(&mut self, bytes: &mut [u8]) -> std::io::Result<usize> {
        self.stream.set_read_timeout(self.remaining()?)?;
        self.stream.read(bytes)
    }
}

impl Write for Connection {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        self.stream.set_write_timeout(self.remaining()?)?;
        self.stream.write(bytes)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.stream.flush()
    }
}

/// Sends a request and returns the response, up to 4 MiB of it. The request must contain `Connection: close`, since the
/// end of the response is the end of the stream.
///
/// # Errors
/// The stream fails. After the first byte of the response, the end of TLS without a closing alert is not an error.
pub fn exchange(mut stream: impl Read + Write, request: &str) -> std::io::Result<String> {
    stream.write_all(request.as_bytes())?;
    let mut text = Vec::new();
    match stream.take(MAX_RESPONSE_BYTES).read_to_end(&mut text) {
        Ok(_) => {}
        // Some servers end TLS without a closing alert.
        Err(e) if e.kind() == ErrorKind::UnexpectedEof && !text.is_empty() => {}
        Err(e) => return Err(e),
    }
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// TLS configuration that trusts only this certificate. Gateways and fleet servers use self-signed certificates.
///
/// # Errors
/// TLS rejects the certificate.
pub fn trusting(certificate: CertificateDer<'_>) -> Result<Arc<ClientConfig>, CertificateError> {
    let mut roots = RootCertStore::empty();
    roots.add(certificate.into_owned())?;
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()?
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(Arc::new(config))
}

/// Wraps a stream in TLS.
///
/// # Errors
/// TLS rejects the configuration or the server name.
pub fn encrypted(
    stream: Connection,
    config: Arc<ClientConfig>,
    name: ServerName<'static>,
) -> Result<StreamOwned<ClientConnection, Connection>, rustls::Error> {
    let connection = ClientConnection::new(config, name)?;
    Ok(StreamOwned::new(connection, stream))
}
