//! Tests of the deadline of requests whose response does not end.

use std::{
    io::Write,
    net::TcpListener,
    thread,
    time::{Duration, Instant},
};

use tokio_rustls::rustls::pki_types::{CertificateDer, ServerName, pem::PemObject};
use volcomp_web::{
    client::{self, Connection},
    tls,
};

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
        let listener = TcpListener::bind("127.0.0.1:0").expect("free");
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
