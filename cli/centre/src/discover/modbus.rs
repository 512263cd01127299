//! A Modbus module: its identification (function 43, MEI type 14, read device identification).

use std::{io, net::SocketAddr};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::TcpStream,
};

use super::{Device, Kind, clean};

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

pub(super) async fn probe(at: SocketAddr, mut stream: TcpStream) -> Device {
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
