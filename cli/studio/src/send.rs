//! Sends the fitted machine file to a gateway or to the centre over their HTTP APIs.
//!
//! The gateway compares the file with the active model; the centre stores the file. Neither corrects with the file
//! until an engineer confirms it there.

use std::{
    net::ToSocketAddrs,
    sync::Arc,
    time::{Duration, Instant},
};

use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use tokio_rustls::rustls::{
    ClientConfig,
    pki_types::{CertificateDer, ServerName, pem::PemObject},
};
use url::Url;
use volcomp_web::{
    CertificateError,
    client::{self, Connection},
};

use crate::{
    error::{Interrupt, StudioError},
    folder::{FITTED, Folder, MACHINE},
};

/// Timeout of one request including its response.
const TIMEOUT: Duration = Duration::from_secs(15);
const COMPARE_TIMEOUT: Duration = Duration::from_secs(60);
const POLL_INTERVAL: Duration = Duration::from_millis(300);

/// Destination of the machine file, with credentials. Credentials are not stored.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, tag = "to", rename_all = "lowercase")]
pub enum Target {
    /// The gateway of a machine.
    Gateway {
        /// Address of the gateway's dashboard, `http://192.0.2.7:8080`.
        url: String,
        /// Token of an engineer.
        token: String,
        /// Trusted certificate, PEM; required for `https`.
        #[serde(default)]
        certificate: String,
    },
    /// The centre that manages many machines.
    Centre {
        /// Address of the centre's web interface.
        url: String,
        /// Name of a user with the role engineer.
        name: String,
        password: String,
        /// Trusted certificate, PEM; required for `https`.
        #[serde(default)]
        certificate: String,
    },
}

/// Response of the gateway or the centre.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Delivery {
    /// The outcome in a sentence.
    pub said: String,
    /// Messages to read before confirming the machine file.
    pub warnings: Vec<String>,
    /// The page on which an engineer confirms the machine file.
    pub page: String,
}

impl Folder {
    /// Sends `result/machine.toml`.
    ///
    /// # Errors
    /// The folder has no result, the request timed out, or it was rejected.
    pub fn send(&self, target: &Target) -> Result<Delivery, StudioError> {
        // Parse the file as a machine first, so that a damaged file is reported here and not by the peer.
        self.fitted_machine()?;
        self.interrupt.check()?;
        let text = String::from_utf8_lossy(&self.result(FITTED)?).into_owned();
        match target {
            Target::Gateway { url, token, certificate } => {
                let server = Server::new(url, certificate)?;
                to_gateway(&server, token, &text, &self.interrupt)
            }
            Target::Centre { url, name, password, certificate } => {
                to_centre(&Server::new(url, certificate)?, [name, password], &text)
            }
        }
    }
}

fn to_gateway(
    server: &Server,
    token: &str,
    text: &str,
    interrupt: &Interrupt,
) -> Result<Delivery, StudioError> {
    let headers = [("Authorization", format!("Bearer {token}"))];
    let upload = format!("/api/model/upload?kind=machine&name={MACHINE}");
    let sent = server.request("POST", &upload, &headers, text)?;
    sent.accepted(server)?;
    let begun = Instant::now();
    let candidate = loop {
        let answer = server.request("GET", "/api/model/candidate", &headers, "")?;
        let candidate = answer.accepted(server)?;
        match candidate["step"].as_str() {
            Some("working") => {}
            Some(_) => break candidate,
            None => return Err(server.failed(&"answers without the key `step`: it is no gateway")),
        }
        if begun.elapsed() > COMPARE_TIMEOUT {
            return Err(server.failed(&"the gateway has not compared the machine file in time"));
        }
        interrupt.check()?;
        std::thread::sleep(POLL_INTERVAL);
    };
    if let Some(error) = candidate["error"].as_str() {
        return Err(server.failed(&error));
    }
    let result = &candidate["result"];
    let refusal = result["refusal"].as_str().map(ToOwned::to_owned);
    Ok(Delivery {
        said: "The gateway has the machine file and has compared it with its model. An engineer activates it on the gateway's page Model.".to_owned(),
        warnings: refusal.into_iter().chain(texts(&result["warnings"])).collect(),
        page: server.url("/model"),
    })
}

fn to_centre(
    server: &Server,
    [name, password]: [&String; 2],
    text: &str,
) -> Result<Delivery, StudioError> {
    // The centre rejects changes without this header.
    let ours = ("X-Volcomp", "1".to_owned());
    let login = json!({ "name": name, "password": password }).to_string();
    let answer = server.request("POST", "/api/login", std::slice::from_ref(&ours), &login)?;
    answer.accepted(server)?;
    let cookie = answer.header("set-cookie").unwrap_or_default();
    let cookie = cookie.split(';').next().unwrap_or_default().to_owned();
    let headers = [ours, ("Cookie", cookie)];
    let body = json!({ "text": text, "file": MACHINE }).to_string();
    let answer = server.request("POST", "/api/models", &headers, &body);
    // Log out whether or not the centre accepted the model. Without a response the session times out.
    let _ = server.request("POST", "/api/logout", &headers, "{}");
    let answer = answer?.accepted(server)?;
    let model = &answer["model"];
    let said = match answer["added"].as_bool() {
        Some(false) => "The centre already has this machine file.",
        _ => "The centre has the machine file. An engineer rolls it out there.",
    };
    Ok(Delivery { said: said.to_owned(), warnings: texts(&model["notes"]), page: server.url("/") })
}

fn texts(list: &Value) -> Vec<String> {
    let list = list.as_array().into_iter().flatten();
    list.filter_map(|text| text.as_str().map(ToOwned::to_owned)).collect()
}

struct Server {
    url: Url,
    host: String,
    port: u16,
    tls: Option<Arc<ClientConfig>>,
}

impl Server {
    fn new(address: &str, certificate: &str) -> Result<Self, StudioError> {
        let wrong = |why: String| StudioError::Request { key: "url", why };
        let expected = "expected an address such as http://192.0.2.7:8080";
        let url = Url::parse(address.trim());
        let url = url.map_err(|e| wrong(format!("found {address:?}: {e}; {expected}")))?;
        let tls = match url.scheme() {
            "http" => None,
            "https" => Some(trusting(certificate)?),
            _ => return Err(wrong(format!("found {address:?}, {expected}"))),
        };
        let (Some(host), Some(port)) = (url.host_str(), url.port_or_known_default()) else {
            return Err(wrong(format!("found {address:?}, {expected}")));
        };
        Ok(Self { host: host.trim_matches(['[', ']']).to_owned(), port, tls, url })
    }

    fn url(&self, path: &str) -> String {
        let origin = self.url.origin().ascii_serialization();
        format!("{origin}{path}")
    }

    fn failed(&self, why: &impl ToString) -> StudioError {
        StudioError::Send { address: self.url.origin().ascii_serialization(), why: why.to_string() }
    }

    fn request(
        &self,
        method: &str,
        path: &str,
        headers: &[(&str, String)],
        body: &str,
    ) -> Result<Answer, StudioError> {
        let at = self.url.origin().ascii_serialization();
        let authority = at.split("://").nth(1).unwrap_or_default();
        let mut text = format!("{method} {path} HTTP/1.1\r\nHost: {authority}\r\n");
        for (name, value) in headers {
            if value.contains(['\r', '\n']) {
                return Err(self.failed(&"a name or token with a line break in it"));
            }
            for part in [name, ": ", value, "\r\n"] {
                text += part;
            }
        }
        let length = body.len();
        let end = format!("Content-Length: {length}\r\nConnection: close\r\n\r\n{body}");
        let found = self.exchange(&(text + &end)).map_err(|e| self.failed(&e))?;
        Answer::read(&found).ok_or_else(|| self.failed(&"the answer is not HTTP/1.1"))
    }

    fn exchange(&self, request: &str) -> std::io::Result<String> {
        let mut addresses = (self.host.as_str(), self.port).to_socket_addrs()?;
        let address = addresses.next().ok_or(std::io::ErrorKind::NotFound)?;
        let stream = Connection::open(&address, TIMEOUT)?;
        let Some(config) = &self.tls else {
            return client::exchange(stream, request);
        };
        let name = ServerName::try_from(self.host.clone()).map_err(std::io::Error::other)?;
        let stream = client::encrypted(stream, Arc::clone(config), name);
        client::exchange(stream.map_err(std::io::Error::other)?, request)
    }
}

/// TLS configuration that trusts only the given certificate.
fn trusting(certificate: &str) -> Result<Arc<ClientConfig>, StudioError> {
    let certificate = CertificateDer::from_pem_slice(certificate.as_bytes());
    let trusted = certificate.map_err(CertificateError::from);
    let config = trusted.and_then(client::trusting);
    config.map_err(|e| StudioError::Request {
        key: "certificate",
        why: format!("{e}; expected the server's certificate, PEM"),
    })
}

#[derive(Debug)]
struct Answer {
    status: u16,
    head: String,
    body: String,
}

impl Answer {
    fn read(text: &str) -> Option<Self> {
        let (head, body) = text.split_once("\r\n\r\n")?;
        let status = head.split_whitespace().nth(1)?.parse().ok()?;
        Some(Self { status, head: head.to_owned(), body: body.to_owned() })
    }

    fn header(&self, name: &str) -> Option<&str> {
        let mut lines = self.head.lines().filter_map(|line| line.split_once(':'));
        let found = lines.find(|(key, _)| key.eq_ignore_ascii_case(name));
        found.map(|(_, value)| value.trim())
    }

    fn accepted(&self, server: &Server) -> Result<Value, StudioError> {
        let document: Value = serde_json::from_str(self.body.trim()).unwrap_or_default();
        if self.status == 200 && document.is_object() {
            return Ok(document);
        }
        if self.status == 200 {
            return Err(server.failed(&"is neither a gateway nor a centre: check the address"));
        }
        let why = document["error"].as_str();
        let why = why.map_or_else(|| self.body.trim().to_owned(), ToOwned::to_owned);
        Err(server.failed(&format!("status {}: {why}", self.status)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_response_is_parsed_with_its_headers() {
        let text = "HTTP/1.1 409 Conflict\r\nSet-Cookie: a=b; Path=/\r\n\r\n{\"error\":\"busy\"}";
        let answer = Answer::read(text).expect("HTTP");
        assert_eq!(answer.header("set-cookie"), Some("a=b; Path=/"));
        let server = Server::new("http://127.0.0.1:1/x", "").expect("an address");
        let refused = answer.accepted(&server).expect_err("409").to_string();
        assert_eq!(refused, "http://127.0.0.1:1: status 409: busy");
        // A page of another server.
        let page = Answer::read("HTTP/1.1 200 OK\r\n\r\n<html></html>").expect("HTTP");
        let refused = page.accepted(&server).expect_err("no document").to_string();
        assert!(refused.contains("check the address"), "{refused}");
    }

    #[test]
    fn invalid_addresses_are_rejected() {
        for wrong in ["", "192.0.2.7:8080", "ftp://192.0.2.7", "https://192.0.2.7"] {
            assert!(Server::new(wrong, "").is_err(), "{wrong}");
        }
    }
}
