//! A peer nests the values in its first response as deeply as the maximum message length allows. The driver must return
//! an error; the process must not end.

use std::{
    io::{Read as _, Write as _},
    net::{TcpListener, TcpStream},
};

use volcomp_sinumerik::{Nodes, Server, list_axes};

fn numbers(numbers: &[u32]) -> Vec<u8> {
    numbers.iter().flat_map(|n| n.to_le_bytes()).collect()
}

fn send(stream: &mut TcpStream, kind: [u8; 4], body: &[u8]) {
    let size = numbers(&[u32::try_from(8 + body.len()).expect("short")]);
    let message = [&kind[..], &size, body].concat();
    stream.write_all(&message).expect("sent");
}

fn receive(stream: &mut TcpStream) -> Vec<u8> {
    let mut header = [0; 8];
    stream.read_exact(&mut header).expect("a header");
    let size = u32::from_le_bytes(header[4..].try_into().expect("four"));
    let mut body = vec![0; size as usize - 8];
    stream.read_exact(&mut body).expect("a body");
    body
}

/// The number at this offset, and the offset behind it.
fn number(bytes: &[u8], at: usize) -> (u32, usize) {
    let number = bytes[at..at + 4].try_into().expect("four");
    (u32::from_le_bytes(number), at + 4)
}

/// Answers the first messages of the client; the last response has `nested` levels of diagnostics in its header.
fn respond(stream: &mut TcpStream, nested: usize) {
    receive(stream);
    send(stream, *b"ACKF", &numbers(&[0, 65_535, 65_535, 0, 0]));
    let opening = receive(stream);
    let mut at = 4;
    for _ in 0..3 {
        let (length, after) = number(&opening, at);
        let length = if length == u32::MAX { 0 } else { length };
        at = after + length as usize;
    }
    let (request, at) = number(&opening, at + 4);
    // Offset of the handle: after the node id of the type, the null token and the time.
    let (handle, _) = number(&opening, at + 4 + 2 + 8);
    let none = b"http://opcfoundation.org/UA/SecurityPolicy#None";
    let policy = [&numbers(&[47])[..], none].concat();
    let absent = numbers(&[u32::MAX]);
    let channel = [&numbers(&[1])[..], &policy, &absent, &absent, &numbers(&[1, request])].concat();
    let header = [&[1, 0][..], &449_u16.to_le_bytes(), &[0; 8], &numbers(&[handle, 0])].concat();
    let diagnostics = vec![0x40; nested];
    let rest = [&[0][..], &absent, &[0; 3]].concat();
    send(stream, *b"OPNF", &[channel, header, diagnostics, rest].concat());
}

#[test]
fn nested_diagnostics_are_an_error() {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
    let url = format!("opc.tcp://{}", listener.local_addr().expect("bound"));
    let peer = std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("a client");
        respond(&mut stream, 32 * 1024 - 300);
        // Wait until the client closes the connection.
        let _ = stream.read(&mut [0]);
    });
    let refused = list_axes(&Server::new(&*url), &Nodes::default());
    assert!(refused.is_err(), "{refused:?}");
    peer.join().expect("it heard a client");
}
