//! Tests the limit on the connections of all servers of a program together. This is a separate test program, because
//! other tests would share the limit.

use std::time::Duration;

use axum::{Router, routing::get};
use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
};

/// Many servers with 64 connections each would use up all file descriptors. Above 256 connections, the oldest
/// connection of all servers is closed, and the newest is served.
#[tokio::test]
async fn all_servers_share_a_connection_limit() {
    let mut hang = Vec::new();
    for _ in 0..6 {
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("free");
        let address = listener.local_addr().expect("bound");
        let router = Router::new().route("/", get(async || "here"));
        tokio::spawn(volcomp_web::serve(listener, None, router));
        // The server has 63 idle connections, one fewer than its maximum, and serves one more.
        for _ in 0..63 {
            hang.push(TcpStream::connect(address).await.expect("served"));
        }
        let mut asks = TcpStream::connect(address).await.expect("served");
        let ask = b"GET / HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
        asks.write_all(ask).await.expect("sent");
        let mut answer = String::new();
        asks.read_to_string(&mut answer).await.expect("an answer");
        assert!(answer.ends_with("here"), "{answer}");
    }
    // Of 378 idle connections at most 256 stay open.
    let (older, newer) = hang.split_at_mut(378 - 256);
    for ended in older {
        assert_eq!(ended.read(&mut [0]).await.unwrap_or(0), 0);
    }
    let newest = newer.last_mut().expect("256");
    let waits = tokio::time::timeout(Duration::from_millis(1), newest.read(&mut [0])).await;
    assert!(waits.is_err(), "the newest is open");
}
