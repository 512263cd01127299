//! The demonstration: it shows three machines that correct, and leaves nothing behind.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    path::Path,
    time::Duration,
};

use volcomp_centre::demo::Demo;
use volcomp_fleet::server;
use volcomp_test_support::{peers, until};

fn ask(address: SocketAddr, request: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("it listens");
    stream.write_all(request.as_bytes()).expect("sent");
    let mut text = String::new();
    stream.read_to_string(&mut text).expect("an answer");
    text
}

#[test]
fn three_machines_correct_and_nothing_is_left() {
    if server::program().is_none() {
        peers::not_run("nats-server");
        return;
    }
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()
        .expect("threads");
    let listen = SocketAddr::from(([127, 0, 0, 1], 0));
    let demo = runtime.block_on(Demo::start(listen)).expect("it starts");
    let (folder, id) = (demo.folder().to_owned(), demo.server_id().expect("it runs"));
    let body = serde_json::json!({ "name": demo.user, "password": demo.password }).to_string();
    let address = demo.address;
    let login = ask(
        address,
        &format!(
            "POST /api/login HTTP/1.1\r\nHost: {address}\r\nX-Volcomp: 1\r\nConnection: close\r\nContent-Length: {}\r\n\r\n{body}",
            body.len()
        ),
    );
    let cookie = login
        .lines()
        .find_map(|line| line.strip_prefix("set-cookie: "))
        .and_then(|line| line.split(';').next())
        .expect("a cookie");
    let get = format!(
        "GET /api/overview HTTP/1.1\r\nHost: {address}\r\nCookie: {cookie}\r\nConnection: close\r\n\r\n"
    );
    let mut last = String::new();
    until("three machines correct", Duration::from_secs(180), || {
        last = ask(address, &get);
        last.matches("\"state\":\"compensating\"").count() == 3
    });
    assert!(last.contains("Demonstration"), "{last}");
    runtime.block_on(demo.end());
    drop(runtime);
    until("the server has ended", Duration::from_secs(60), || {
        !Path::new(&format!("/proc/{id}")).exists()
    });
    assert!(!folder.exists());
}
