//! Asks a running gateway for its state.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    path::Path,
    sync::Arc,
    time::Duration,
};

use tokio_rustls::rustls::{
    ClientConfig, ClientConnection, RootCertStore, StreamOwned,
    crypto::ring,
    pki_types::{CertificateDer, ServerName, pem::PemObject},
};

use volcomp_web::{CertificateError, TlsError};

use crate::{config::DashboardConfig, documents::Status, error::GatewayError};

/// A gateway that answers later counts as one that does not.
const AT_MOST: Duration = Duration::from_secs(3);

/// Asks the gateway behind a dashboard for its state; `token` where reading needs one.
///
/// # Errors
/// Nobody answers, or the answer is no state of a gateway.
pub fn ask(dashboard: &DashboardConfig, token: Option<&str>) -> Result<Status, GatewayError> {
    let mut address = dashboard.listen;
    if address.ip().is_unspecified() {
        address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
    }
    let failed = |e: std::io::Error| GatewayError::system(format!("gateway at {address}"), e);
    let stream = TcpStream::connect_timeout(&address, AT_MOST).map_err(failed)?;
    stream.set_read_timeout(Some(AT_MOST)).map_err(failed)?;
    let authorization = token.map_or(String::new(), |token| {
        format!("Authorization: Bearer {token}\r\n")
    });
    let request = format!(
        "GET /api/state HTTP/1.1\r\nHost: {address}\r\n{authorization}Connection: close\r\n\r\n"
    );
    let text = match &dashboard.tls_certificate {
        None => exchange(stream, &request),
        Some(certificate) => exchange(encrypted(stream, address, certificate)?, &request),
    }
    .map_err(failed)?;
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    let status = head.split_whitespace().nth(1).unwrap_or_default();
    if status != "200" {
        return Err(GatewayError::Answer {
            address,
            what: format!("it answers {status}: {}", body.trim()),
        });
    }
    serde_json::from_str(body.trim()).map_err(|e| GatewayError::Answer {
        address,
        what: format!("its answer is no state: {e}"),
    })
}

fn exchange(mut stream: impl Read + Write, request: &str) -> std::io::Result<String> {
    stream.write_all(request.as_bytes())?;
    let mut text = Vec::new();
    match stream.read_to_end(&mut text) {
        Ok(_) => {}
        // Some end without the closing alert.
        Err(e) if e.kind() == std::io::ErrorKind::UnexpectedEof && !text.is_empty() => {}
        Err(e) => return Err(e),
    }
    Ok(String::from_utf8_lossy(&text).into_owned())
}

/// The gateway's own certificate is all that is trusted.
fn encrypted(
    stream: TcpStream,
    address: SocketAddr,
    certificate: &Path,
) -> Result<StreamOwned<ClientConnection, TcpStream>, GatewayError> {
    let wrong = |source: CertificateError| TlsError::Certificate {
        file: certificate.to_owned(),
        source,
    };
    let mut roots = RootCertStore::empty();
    roots
        .add(CertificateDer::from_pem_file(certificate).map_err(|e| wrong(e.into()))?)
        .map_err(|e| wrong(e.into()))?;
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|e| wrong(e.into()))?
        .with_root_certificates(roots)
        .with_no_client_auth();
    let connection = ClientConnection::new(Arc::new(config), ServerName::from(address.ip()))
        .map_err(|e| wrong(e.into()))?;
    Ok(StreamOwned::new(connection, stream))
}
