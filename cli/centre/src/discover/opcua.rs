//! An OPC UA server: hello, a channel without security, and the question for its endpoints. No session is opened.

use std::{io, net::SocketAddr};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

use super::{
    Device, Kind,
    make::make_of,
    opcua_wire::{LONGEST, get_endpoints, hello, open, parse_endpoints, parse_opened},
};

pub(super) async fn ask(at: SocketAddr, mut stream: TcpStream) -> Device {
    match questions(at, &mut stream).await {
        Ok(device) => device,
        Err(error) => Device::other(at, Kind::OpcUa, error.to_string()),
    }
}

async fn questions(at: SocketAddr, stream: &mut TcpStream) -> io::Result<Device> {
    let url = format!("opc.tcp://{at}");
    stream.write_all(&hello(&url)).await?;
    let (kind, _) = message(stream).await?;
    match &kind {
        b"ACKF" => {}
        b"ERRF" => {
            // It speaks the language, and refuses: by the name of its endpoint, mostly.
            let mut device = Device::at(at, Kind::OpcUa);
            "it refuses the hello".clone_into(&mut device.note);
            return Ok(device);
        }
        _ => return Err(io::Error::other("its answer is no OPC UA message")),
    }
    let mut device = Device::at(at, Kind::OpcUa);
    "it does not tell its endpoints without security".clone_into(&mut device.note);
    stream.write_all(&open()).await?;
    let opened = match message(stream).await {
        Ok((kind, body)) if kind == *b"OPNF" => parse_opened(&body),
        _ => None,
    };
    let Some(channel) = opened else {
        return Ok(device);
    };
    stream.write_all(&get_endpoints(channel, &url)).await?;
    let told = match message(stream).await {
        Ok((kind, body)) if kind == *b"MSGF" => parse_endpoints(&body),
        _ => None,
    };
    if let Some(endpoint) = told {
        device.control = make_of(&[&endpoint.name, &endpoint.product]);
        device.name = endpoint.name;
        let mut notes = Vec::new();
        if !endpoint.product.is_empty() {
            notes.push(format!("product {}", endpoint.product));
        }
        if !endpoint.policies.is_empty() {
            notes.push(format!("security: {}", endpoint.policies.join(", ")));
        }
        device.note = super::clean(&notes.join("; "));
    }
    Ok(device)
}

/// The kind and the body of the next message; only messages of one piece are taken.
async fn message(stream: &mut TcpStream) -> io::Result<([u8; 4], Vec<u8>)> {
    let mut head = [0; 8];
    stream.read_exact(&mut head).await?;
    let [a, b, c, d, length @ ..] = head;
    let length = usize::try_from(u32::from_le_bytes(length)).unwrap_or(usize::MAX);
    if !(8..=LONGEST).contains(&length) {
        return Err(io::Error::other("its answer is no OPC UA message"));
    }
    let mut body = vec![0; length - 8];
    stream.read_exact(&mut body).await?;
    Ok(([a, b, c, d], body))
}
