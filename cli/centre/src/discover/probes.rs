//! Probes of a network address by read requests, for a volcomp gateway, a FANUC control and a Modbus module.
//!
//! A gateway is identified by its web page; its state, if readable without a token, names the machine that it corrects.
//! A FANUC control is identified by its type, software and axis letters, a Modbus module by its identification
//! (function 43, MEI type 14).

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
use volcomp_focas::{Client, FocasError};

use crate::discover::{Device, Kind, RateLimiter, clean};

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

pub(super) async fn probe_gateway(
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

/// Queries the control on a blocking thread; each request has the timeout `at_most`.
pub(super) async fn probe_focas(at: SocketAddr, at_most: Duration) -> Device {
    let asked = tokio::task::spawn_blocking(move || questions(at, at_most)).await;
    match asked {
        Ok(Ok(device)) => device,
        Ok(Err(error)) => Device::other(at, Kind::Focas, error.to_string()),
        Err(_) => Device::other(at, Kind::Focas, "the question failed"),
    }
}

fn questions(at: SocketAddr, at_most: Duration) -> Result<Device, FocasError> {
    let mut client = Client::open(&at.ip().to_string(), at.port(), at_most)?;
    let mut device = Device::at(at, Kind::Focas);
    let info = client.system_info()?;
    device.control = clean(&format!(
        "FANUC {} {} series {} {}",
        info.cnc_type, info.machine_type, info.series, info.version
    ));
    // A control that reports its type but not its axes is still a control.
    match client.axis_names() {
        Ok(mut names) => {
            // Use as many names as the path reports axes: some controls return unused slots with arbitrary letters
            // after them.
            if let Ok(count) = info.axes.trim().parse::<usize>()
                && count > 0
            {
                names.truncate(count);
            }
            names.truncate(32);
            device.axes = names;
        }
        Err(error) => device.note = clean(&error.to_string()),
    }
    Ok(device)
}

/// Unit identifiers to query: a module with its own network port, then the first unit on a serial converter.
const UNIT_IDS: [u8; 2] = [255, 1];
/// Function code 43 (encapsulated interface) and MEI type 14 (device identification).
const FUNCTION: [u8; 2] = [0x2b, 0x0e];
/// Maximum length of a Modbus TCP frame after its length field, bytes.
const MAX_FRAME_BYTES: usize = 254;

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Identification {
    /// Vendor, product and revision, as far as reported.
    Objects([Option<String>; 3]),
    /// Exception code: the module does not support this function, or not for this unit.
    Refused(u8),
}

/// Parses a response after its header: the function code and its data. `None` if it is malformed.
pub fn parse_identification(pdu: &[u8]) -> Option<Identification> {
    match pdu {
        [function, code, ..] if *function == FUNCTION[0] | 0x80 => {
            Some(Identification::Refused(*code))
        }
        // Bytes skipped after the MEI type: read code, conformity level, more follows, next object.
        [0x2b, 0x0e, _, _, _, _, count, rest @ ..] => {
            let mut objects: [Option<String>; 3] = [None, None, None];
            let mut rest = rest;
            for _ in 0..*count {
                let [id, length, behind @ ..] = rest else {
                    return None;
                };
                let text = behind.get(..usize::from(*length))?;
                rest = &behind[usize::from(*length)..];
                if let Some(object) = objects.get_mut(usize::from(*id)) {
                    *object = Some(clean(&String::from_utf8_lossy(text)));
                }
            }
            Some(Identification::Objects(objects))
        }
        _ => None,
    }
}

pub(super) async fn probe_modbus(at: SocketAddr, mut stream: TcpStream) -> Device {
    let mut device = Device::at(at, Kind::Modbus);
    for (number, unit) in UNIT_IDS.into_iter().enumerate() {
        let transaction = 0x5643 + u16::try_from(number).unwrap_or(0);
        match question(&mut stream, transaction, unit).await {
            Ok(Some(Identification::Objects([vendor, product, revision]))) => {
                let words: Vec<String> = [vendor, product].into_iter().flatten().collect();
                device.control = clean(&words.join(" "));
                device.note = revision
                    .map_or_else(String::new, |revision| clean(&format!("revision {revision}")));
                return device;
            }
            Ok(Some(Identification::Refused(code))) => {
                device.note = format!("it does not report its type (exception {code})");
            }
            Ok(None) => return Device::other(at, Kind::Modbus, "its response is no Modbus frame"),
            Err(error) if device.note.is_empty() => {
                return Device::other(at, Kind::Modbus, error.to_string());
            }
            // A response to an earlier unit identifier has already identified the device as a Modbus module.
            Err(_) => return device,
        }
    }
    device
}

async fn question(
    stream: &mut TcpStream,
    transaction: u16,
    unit: u8,
) -> io::Result<Option<Identification>> {
    let [high, low] = transaction.to_be_bytes();
    let [function, mei] = FUNCTION;
    stream.write_all(&[high, low, 0, 0, 0, 5, unit, function, mei, 1, 0]).await?;
    let mut head = [0; 7];
    stream.read_exact(&mut head).await?;
    let length = usize::from(u16::from_be_bytes([head[4], head[5]]));
    let is_ours = head[..4] == [high, low, 0, 0];
    if !is_ours || !(2..=MAX_FRAME_BYTES).contains(&length) {
        return Ok(None);
    }
    let mut pdu = vec![0; length - 1];
    stream.read_exact(&mut pdu).await?;
    Ok(parse_identification(&pdu))
}
