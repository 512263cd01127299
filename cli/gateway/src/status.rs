//! What a running gateway says, for a terminal.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    path::Path,
    sync::Arc,
    time::Duration,
};

use serde_json::Value;
use tokio_rustls::rustls::{
    ClientConfig, ClientConnection, RootCertStore, StreamOwned,
    crypto::ring,
    pki_types::{CertificateDer, ServerName, pem::PemObject},
};

use crate::{config::DashboardConfig, error::GatewayError};

const AT_MOST: Duration = Duration::from_secs(3);

/// Asks a gateway for its state; `token` where reading needs one.
///
/// # Errors
/// Nobody answers, or not as a gateway does.
pub fn ask(dashboard: &DashboardConfig, token: Option<&str>) -> Result<Value, GatewayError> {
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
    let text = match &dashboard.tls {
        None => exchange(stream, &request),
        Some((certificate, _)) => exchange(encrypted(stream, address, certificate)?, &request),
    }
    .map_err(failed)?;
    let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
    let status = head.split_whitespace().nth(1).unwrap_or_default();
    if status != "200" {
        return Err(failed(std::io::Error::other(format!(
            "it answers {status}: {}",
            body.trim()
        ))));
    }
    serde_json::from_str(body.trim()).map_err(|e| failed(std::io::Error::other(e)))
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
    let wrong =
        |e: &dyn std::fmt::Display| GatewayError::Unfit(format!("{}: {e}", certificate.display()));
    let mut roots = RootCertStore::empty();
    roots
        .add(CertificateDer::from_pem_file(certificate).map_err(|e| wrong(&e))?)
        .map_err(|e| wrong(&e))?;
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|e| wrong(&e))?
        .with_root_certificates(roots)
        .with_no_client_auth();
    let connection = ClientConnection::new(Arc::new(config), ServerName::from(address.ip()))
        .map_err(|e| wrong(&e))?;
    Ok(StreamOwned::new(connection, stream))
}

/// The state in lines.
pub fn text(state: &Value) -> String {
    let word = |value: &Value| {
        value
            .as_str()
            .map_or_else(|| value.to_string(), str::to_owned)
    };
    let list = |value: &Value| {
        value
            .as_array()
            .into_iter()
            .flatten()
            .map(&word)
            .collect::<Vec<_>>()
            .join(", ")
    };
    let named = |value: &Value| {
        value
            .as_object()
            .into_iter()
            .flatten()
            .map(|(name, value)| format!("{name} {value}"))
            .collect::<Vec<_>>()
            .join("  ")
    };
    let cycle = &state["cycle"];
    let mut lines = vec![format!("state           {}", word(&state["state"]))];
    let mut add = |title: &str, text: String| {
        if !text.is_empty() {
            lines.push(format!("{title:<16}{text}"));
        }
    };
    add("because", list(&state["reasons"]));
    add("machine", word(&state["machine"]["name"]));
    add("controller", word(&state["controller"]["device"]));
    add("position, mm", named(&state["positions_mm"]));
    add("deg", named(&state["positions_deg"]));
    add("correction, um", named(&state["correction_um"]));
    add("urad", named(&state["correction_urad"]));
    for temperature in state["temperatures"].as_array().into_iter().flatten() {
        let degc = temperature["degc"]
            .as_f64()
            .map_or("-".to_owned(), |degc| format!("{degc:.1} degC"));
        let why = temperature["reason"]
            .as_str()
            .map_or(String::new(), |why| format!(" ({why})"));
        add(
            "temperature",
            format!("{} {degc}{why}", word(&temperature["name"])),
        );
    }
    add(
        "cycles",
        format!(
            "{}, p50 {} us, p99 {} us, {} overruns",
            cycle["count"], cycle["p50_us"], cycle["p99_us"], cycle["overruns"]
        ),
    );
    lines.join("\n") + "\n"
}
