//! HTTP requests to a running gateway.

use std::{net::SocketAddr, path::Path, path::PathBuf, time::Duration};

use tokio_rustls::rustls::{
    ClientConnection, StreamOwned,
    pki_types::{CertificateDer, ServerName, pem::PemObject},
};
use volcomp_web::{
    CertificateError, TlsError,
    client::{self, Connection},
};

use crate::{config::DashboardConfig, error::GatewayError};

/// Options that reach a running gateway.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct RunningArguments {
    /// The configuration with which it runs
    #[arg(long)]
    config: Option<PathBuf>,
    /// The address and port of its dashboard
    #[arg(long)]
    listen: Option<SocketAddr>,
    /// File with a token: the last word of its first line
    #[arg(long)]
    token_file: Option<PathBuf>,
}

impl RunningArguments {
    /// Address and certificate of the dashboard.
    ///
    /// # Errors
    /// The configuration is invalid.
    pub fn dashboard(&self) -> Result<DashboardConfig, GatewayError> {
        let mut dashboard = match &self.config {
            Some(path) => {
                DashboardConfig::read(path).map_err(|e| GatewayError::running_without(&e))?
            }
            None => DashboardConfig::default(),
        };
        if let Some(listen) = self.listen {
            dashboard.listen = listen;
        }
        Ok(dashboard)
    }

    /// The token. The file holds a single token, or lines in the format of the gateway's token file.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn token(&self) -> Result<Option<String>, GatewayError> {
        let Some(path) = &self.token_file else {
            return Ok(None);
        };
        let text = std::fs::read_to_string(path)
            .map_err(|source| GatewayError::Read { file: path.display().to_string(), source })?;
        let lines = text.lines();
        let mut lines = lines.map(|line| line.split('#').next().unwrap_or_default());
        let token = lines.find_map(|line| line.split_whitespace().last());
        Ok(token.map(str::to_owned))
    }
}

/// Response of a gateway.
#[derive(Clone, Debug)]
pub struct Response {
    /// Address of the gateway, used in messages.
    pub address: SocketAddr,
    /// HTTP status; 0 if the response is not HTTP.
    pub status: u16,
    pub body: String,
}

impl Response {
    /// What a refused call lacks: the option that states a token.
    pub fn needs_token(&self, token: Option<&str>) -> &'static str {
        if self.status == 401 && token.is_none() { ": state it with --token-file FILE" } else { "" }
    }
}

/// Sends a request, such as `GET /api/state`, to the gateway of a dashboard configuration.
///
/// # Errors
/// The gateway cannot be reached, or does not respond within `within`.
pub fn exchange(
    dashboard: &DashboardConfig,
    token: Option<&str>,
    request: &str,
    body: &str,
    within: Duration,
) -> Result<Response, GatewayError> {
    let mut address = dashboard.listen;
    if address.ip().is_unspecified() {
        address.set_ip(std::net::Ipv4Addr::LOCALHOST.into());
    }
    let failed = |e: std::io::Error| GatewayError::system(format!("gateway at {address}"), e);
    let stream = Connection::open(&address, within).map_err(failed)?;
    let authorization =
        token.map_or(String::new(), |token| format!("Authorization: Bearer {token}\r\n"));
    let request = format!(
        "{request} HTTP/1.1\r\nHost: {address}\r\n{authorization}Content-Length: {}\r\nConnection: close\r\n\r\n{body}",
        body.len()
    );
    let text = match &dashboard.tls_certificate {
        None => client::exchange(stream, &request),
        Some(certificate) => client::exchange(encrypted(stream, address, certificate)?, &request),
    }
    .map_err(failed)?;
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    let status = head.split_whitespace().nth(1);
    Ok(Response {
        address,
        status: status.and_then(|status| status.parse().ok()).unwrap_or(0),
        body: body.trim().to_owned(),
    })
}

fn encrypted(
    stream: Connection,
    address: SocketAddr,
    certificate: &Path,
) -> Result<StreamOwned<ClientConnection, Connection>, GatewayError> {
    let wrong =
        |source: CertificateError| TlsError::Certificate { file: certificate.to_owned(), source };
    let trusted = CertificateDer::from_pem_file(certificate).map_err(|e| wrong(e.into()))?;
    let config = client::trusting(trusted).map_err(wrong)?;
    let name = ServerName::from(address.ip());
    Ok(client::encrypted(stream, config, name).map_err(|e| wrong(e.into()))?)
}
