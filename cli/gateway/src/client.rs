//! Requests the state of a running gateway.

use std::{
    net::{SocketAddr, TcpStream},
    path::Path,
    time::Duration,
};

use tokio_rustls::rustls::{
    ClientConnection, StreamOwned,
    pki_types::{CertificateDer, ServerName, pem::PemObject},
};
use volcomp_web::{CertificateError, TlsError, client};

use crate::{config::DashboardConfig, documents::Status, error::GatewayError};

/// Timeout for connecting and for each read.
const AT_MOST: Duration = Duration::from_secs(3);

/// Requests the state from the gateway of a dashboard configuration. `token` is required where reading needs one.
///
/// # Errors
/// No response, or the response is not the state of a gateway.
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
        None => client::exchange(stream, &request),
        Some(certificate) => client::exchange(encrypted(stream, address, certificate)?, &request),
    }
    .map_err(failed)?;
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    let status = head.split_whitespace().nth(1).unwrap_or_default();
    if status != "200" {
        return Err(GatewayError::failed(format!(
            "gateway at {address}: it answers {status}: {}",
            body.trim()
        )));
    }
    serde_json::from_str(body.trim()).map_err(|e| {
        GatewayError::failed(format!("gateway at {address}: its answer is no state: {e}"))
    })
}

/// Trusts the gateway's own certificate only.
fn encrypted(
    stream: TcpStream,
    address: SocketAddr,
    certificate: &Path,
) -> Result<StreamOwned<ClientConnection, TcpStream>, GatewayError> {
    let wrong = |source: CertificateError| TlsError::Certificate {
        file: certificate.to_owned(),
        source,
    };
    let trusted = CertificateDer::from_pem_file(certificate).map_err(|e| wrong(e.into()))?;
    let config = client::trusting(trusted).map_err(wrong)?;
    let name = ServerName::from(address.ip());
    Ok(client::encrypted(stream, config, name).map_err(|e| wrong(e.into()))?)
}
