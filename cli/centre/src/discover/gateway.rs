//! A volcomp gateway: its web page identifies it. Its state, if readable without a token, names the machine that it
//! corrects.

use std::{io, net::SocketAddr, sync::Arc, time::Duration};

use serde::Deserialize;
use tokio::{
    io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt},
    net::TcpStream,
};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, DigitallySignedStruct, Error, SignatureScheme,
        client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier},
        crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature},
        pki_types::{CertificateDer, ServerName, UnixTime},
    },
};

use super::{Device, Kind, RateLimiter, clean};

const MAX_RESPONSE_BYTES: u64 = 256 * 1024;
const TITLE: &str = "<title>volcomp gateway</title>";

#[derive(Deserialize)]
struct State {
    #[serde(rename = "state")]
    of_guard: String,
    #[serde(default)]
    simulated: bool,
    machine: Machine,
}

#[derive(Deserialize)]
struct Machine {
    #[serde(default)]
    name: String,
    #[serde(default)]
    structure: Option<String>,
    #[serde(default)]
    axes: Vec<String>,
}

pub(super) async fn probe(
    at: SocketAddr,
    stream: TcpStream,
    pace: &RateLimiter,
    within: Duration,
) -> Device {
    let with = Connector { at, pace, within };
    let plain = get(stream, at, "/").await;
    let (page, tls) = match plain {
        Ok(page) => (Ok(page), false),
        // A service that does not speak plain HTTP may speak HTTPS.
        Err(_) => (with.get("/", true).await, true),
    };
    let Ok(page) = page else {
        return Device::other(at, Kind::Gateway, "its answer is no HTTP");
    };
    if !page.body.contains(TITLE) {
        return Device::other(at, Kind::Gateway, "another web page");
    }
    let mut device = Device::at(at, Kind::Gateway);
    "volcomp-gateway".clone_into(&mut device.control);
    match with.get("/api/state", tls).await {
        Ok(answer) if answer.status == 200 => match serde_json::from_str::<State>(&answer.body) {
            Ok(state) => {
                device.name = clean(&state.machine.name);
                device.structure = state.machine.structure.map(|structure| clean(&structure));
                let letters = state.machine.axes.iter().take(9);
                let letters = letters.filter_map(|axis| axis.chars().next());
                device.axes = letters.filter(char::is_ascii_uppercase).collect();
                let simulated = if state.simulated { ", simulated" } else { "" };
                device.note = clean(&format!("{}{simulated}", state.of_guard));
            }
            Err(_) => "its state is not in the format of this program".clone_into(&mut device.note),
        },
        Ok(answer) if answer.status == 401 => {
            "reading its state needs a token".clone_into(&mut device.note);
        }
        Ok(answer) => {
            device.note = format!("it does not report its state (HTTP {})", answer.status);
        }
        Err(_) => "it does not report its state".clone_into(&mut device.note),
    }
    device
}

struct Connector<'a> {
    at: SocketAddr,
    pace: &'a RateLimiter,
    within: Duration,
}

impl Connector<'_> {
    async fn get(&self, path: &str, tls: bool) -> io::Result<HttpResponse> {
        self.pace.wait().await;
        let connected = tokio::time::timeout(self.within, TcpStream::connect(self.at)).await;
        let stream = connected.map_err(|_| io::Error::from(io::ErrorKind::TimedOut))??;
        if !tls {
            return get(stream, self.at, path).await;
        }
        let name = ServerName::from(self.at.ip());
        let stream = connector()?.connect(name, stream).await?;
        get(stream, self.at, path).await
    }
}

struct HttpResponse {
    status: u16,
    body: String,
}

async fn get(
    mut stream: impl AsyncRead + AsyncWrite + Unpin,
    at: SocketAddr,
    path: &str,
) -> io::Result<HttpResponse> {
    let request =
        format!("GET {path} HTTP/1.1\r\nHost: {at}\r\nConnection: close\r\nAccept: */*\r\n\r\n");
    stream.write_all(request.as_bytes()).await?;
    let mut bytes = Vec::new();
    match stream.take(MAX_RESPONSE_BYTES).read_to_end(&mut bytes).await {
        // Some servers close TLS without the closing alert.
        Err(_) if !bytes.is_empty() => {}
        other => other.map(|_| ())?,
    }
    let text = String::from_utf8_lossy(&bytes);
    let no_http = || io::Error::other("its answer is no HTTP");
    let (head, body) = text.split_once("\r\n\r\n").ok_or_else(no_http)?;
    let first = head.strip_prefix("HTTP/1.").ok_or_else(no_http)?;
    let status = first.split(' ').nth(1).and_then(|status| status.parse().ok());
    let chunked = head.to_ascii_lowercase().contains("transfer-encoding: chunked");
    Ok(HttpResponse {
        status: status.ok_or_else(no_http)?,
        body: if chunked { unchunked(body) } else { body.to_owned() },
    })
}

/// Decodes a chunked body; an incomplete last chunk is ignored.
fn unchunked(mut body: &str) -> String {
    let mut text = String::new();
    while let Some((length, rest)) = body.split_once("\r\n") {
        let Ok(length @ 1..) = usize::from_str_radix(length.trim(), 16) else {
            break;
        };
        let Some(chunk) = rest.get(..length) else {
            break;
        };
        text.push_str(chunk);
        body = rest.get(length + 2..).unwrap_or_default();
    }
    text
}

fn connector() -> io::Result<TlsConnector> {
    let provider = Arc::new(ring::default_provider());
    let config = ClientConfig::builder_with_provider(Arc::clone(&provider))
        .with_safe_default_protocol_versions()
        .map_err(io::Error::other)?
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(AnyCertificate(provider)))
        .with_no_client_auth();
    Ok(TlsConnector::from(Arc::new(config)))
}

/// Accepts every certificate: gateways sign their own, nothing secret is sent here, and no response is trusted.
#[derive(Debug)]
struct AnyCertificate(Arc<CryptoProvider>);

impl ServerCertVerifier for AnyCertificate {
    fn verify_server_cert(
        &self,
        _: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        Ok(ServerCertVerified::assertion())
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        let algorithms = &self.0.signature_verification_algorithms;
        verify_tls12_signature(message, certificate, signed, algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        let algorithms = &self.0.signature_verification_algorithms;
        verify_tls13_signature(message, certificate, signed, algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.0.signature_verification_algorithms.supported_schemes()
    }
}
