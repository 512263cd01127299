//! Tests of the public interface of the crate.
//!
//! Requests are served and rejected over plain connections and over TLS, and a deadline ends requests whose response
//! does not end.

use std::{
    io::Write,
    os::unix::fs::PermissionsExt,
    sync::Arc,
    thread,
    time::{Duration, Instant},
};

use axum::{Extension, Router, routing::get};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
};
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{CertificateDer, ServerName, pem::PemObject},
    },
};
use volcomp_document::PrivateError;
use volcomp_web::{
    TlsError,
    client::{self, Connection},
    tls,
};

async fn from(Extension(from): Extension<std::net::SocketAddr>) -> String {
    from.ip().to_string()
}

async fn answer(mut stream: TcpStream, request: &str) -> String {
    stream.write_all(request.as_bytes()).await.expect("sent");
    let mut answer = Vec::new();
    let _ = stream.read_to_end(&mut answer).await;
    String::from_utf8_lossy(&answer).into_owned()
}

#[tokio::test]
async fn a_request_carries_its_client_address() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("free");
    let address = listener.local_addr().expect("bound");
    tokio::spawn(volcomp_web::serve(listener, None, Router::new().route("/", get(from))));
    let ask = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let stream = TcpStream::connect(address).await.expect("served");
    assert!(answer(stream, ask).await.ends_with("127.0.0.1"));
}

/// A response has no header `Date`, because this header cannot represent every time that the clock may have.
#[tokio::test]
async fn an_answer_does_not_depend_on_the_wall_clock() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("free");
    let address = listener.local_addr().expect("bound");
    tokio::spawn(volcomp_web::serve(listener, None, Router::new().route("/", get(from))));
    let ask = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let stream = TcpStream::connect(address).await.expect("served");
    let said = answer(stream, ask).await.to_lowercase();
    assert!(said.starts_with("http/1.1 200"), "{said}");
    assert!(!said.contains("\r\ndate:"), "{said}");
}

/// If more clients than the maximum are connected, the oldest connection is closed and the newest is served.
#[tokio::test]
async fn hanging_clients_do_not_block_others() {
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("free");
    let address = listener.local_addr().expect("bound");
    tokio::spawn(volcomp_web::serve(listener, None, Router::new().route("/", get(from))));
    let mut hang = Vec::new();
    for _ in 0..100 {
        let mut client = TcpStream::connect(address).await.expect("served");
        client.write_all(b"GET / HT").await.expect("sent");
        hang.push(client);
    }
    let ask = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    let stream = TcpStream::connect(address).await.expect("served");
    let said = tokio::time::timeout(Duration::from_secs(60), answer(stream, ask)).await;
    assert!(said.expect("in time").starts_with("HTTP/1.1 200"));
}

#[tokio::test]
async fn plain_http_to_a_tls_page_is_not_answered() {
    let dir = tempfile::tempdir().expect("writable");
    let names = ["localhost".to_owned()];
    let [certificate, key] = tls::make(dir.path(), &names).expect("made");
    // Existing files are not overwritten.
    assert!(matches!(tls::make(dir.path(), &names), Err(TlsError::There { .. })));
    let acceptor = tls::acceptor(&certificate, &key).expect("ours");
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("free");
    let address = listener.local_addr().expect("bound");
    tokio::spawn(volcomp_web::serve(listener, Some(acceptor), Router::new().route("/", get(from))));
    let stream = TcpStream::connect(address).await.expect("served");
    let ask = "GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    assert!(!answer(stream, ask).await.contains("200"));
}

#[test]
fn invalid_certificate_files_are_named() {
    let dir = tempfile::tempdir().expect("writable");
    let file = dir.path().join("x.pem");
    std::fs::write(&file, "nothing").expect("writable");
    let Err(error) = tls::acceptor(&file, &file) else {
        panic!("it is no certificate");
    };
    assert!(error.to_string().contains("x.pem"), "{error}");
}

/// A client that trusts the certificate is served over TLS under the names in the certificate. Another name is
/// rejected. A key that other users can read is rejected as well.
#[tokio::test]
async fn a_tls_page_serves_clients_that_trust_its_certificate() {
    let dir = tempfile::tempdir().expect("writable");
    let names = ["centre.shop.lan".to_owned(), "127.0.0.1".to_owned()];
    let [certificate, key] = tls::make(dir.path(), &names).expect("made");
    let acceptor = tls::acceptor(&certificate, &key).expect("ours");
    let listener = TcpListener::bind("127.0.0.1:0").await.expect("free");
    let address = listener.local_addr().expect("bound");
    let router = Router::new().route("/", get(from));
    tokio::spawn(volcomp_web::serve(listener, Some(acceptor), router));
    let mut roots = RootCertStore::empty();
    let trusted = CertificateDer::from_pem_file(&certificate).expect("one");
    roots.add(trusted).expect("a certificate");
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .expect("ours")
        .with_root_certificates(roots)
        .with_no_client_auth();
    let connector = TlsConnector::from(Arc::new(config));
    let ask = "GET / HTTP/1.1\r\nHost: centre.shop.lan\r\nConnection: close\r\n\r\n";
    for (name, is_its) in
        [("centre.shop.lan", true), ("127.0.0.1", true), ("other.shop.lan", false)]
    {
        let stream = TcpStream::connect(address).await.expect("served");
        let name = name.try_into().expect("a name");
        match connector.connect(name, stream).await {
            Ok(mut stream) => {
                assert!(is_its);
                stream.write_all(ask.as_bytes()).await.expect("sent");
                let mut answer = Vec::new();
                stream.read_to_end(&mut answer).await.expect("closed in order");
                let answer = String::from_utf8_lossy(&answer);
                assert!(
                    answer.starts_with("HTTP/1.1 200") && answer.ends_with("127.0.0.1"),
                    "{answer}"
                );
            }
            Err(error) => assert!(!is_its, "{error}"),
        }
    }
    let open = std::fs::Permissions::from_mode(0o640);
    std::fs::set_permissions(&key, open).expect("ours");
    let Err(refused) = tls::acceptor(&certificate, &key) else {
        panic!("others can read the key");
    };
    assert!(matches!(refused, TlsError::Key(PrivateError::Mode { mode: 0o640, .. })));
    let reported = refused.to_string();
    assert!(
        reported.ends_with("key.pem: found mode 640, expected 600: others may read this secret"),
        "{reported}"
    );
}

/// The peer sends a byte every 20 ms without end, in an HTTP response or in a TLS record. The request fails at its
/// deadline.
#[test]
fn a_dripping_peer_does_not_extend_the_deadline() {
    let dir = tempfile::tempdir().expect("writable");
    let [certificate, _] = tls::make(dir.path(), &["localhost".to_owned()]).expect("made");
    let certificate = CertificateDer::from_pem_file(certificate).expect("a certificate");
    let config = client::trusting(certificate).expect("trusted");
    // The second text is the head of a TLS handshake record of 16 384 bytes, for whose end TLS waits.
    for begins in [&b"HTTP/1.1 200 OK\r\n\r\n"[..], b"\x16\x03\x03\x40\x00"] {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").expect("free");
        let address = listener.local_addr().expect("bound");
        thread::spawn(move || {
            let (mut stream, _) = listener.accept().expect("a connection");
            let _ = stream.write_all(begins);
            // Longer than the test may take, but not endless.
            for _ in 0..500 {
                if stream.write_all(b"x").is_err() {
                    return;
                }
                thread::sleep(Duration::from_millis(20));
            }
        });
        let start = Instant::now();
        let stream = Connection::open(&address, Duration::from_millis(300)).expect("served");
        let request = "GET / HTTP/1.1\r\nConnection: close\r\n\r\n";
        let answer = if begins[0] == b'H' {
            client::exchange(stream, request)
        } else {
            let name = ServerName::try_from("localhost").expect("a name");
            let stream = client::encrypted(stream, config.clone(), name).expect("a name");
            client::exchange(stream, request)
        };
        assert!(answer.is_err(), "{answer:?}");
        assert!(start.elapsed() < Duration::from_secs(5), "{answer:?}");
    }
}
