//! The few messages of OPC UA (part 6, binary over TCP, security policy None) by which a server tells its endpoints.

use super::clean;

/// The longest message that is read, bytes.
pub(super) const LONGEST: usize = 256 * 1024;
/// The longest list that is read: more endpoints nobody has.
const MOST: i32 = 256;

const POLICY_NONE: &str = "http://opcfoundation.org/UA/SecurityPolicy#None";
const OPEN_REQUEST: u16 = 446;
const OPEN_RESPONSE: u16 = 449;
const ENDPOINTS_REQUEST: u16 = 428;
const ENDPOINTS_RESPONSE: u16 = 431;

/// What a server says of itself.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Endpoint {
    /// Its product, a URI.
    pub product: String,
    /// Its name.
    pub name: String,
    /// The security policies of its endpoints, the last part of each name, without repetition.
    pub policies: Vec<String>,
}

/// The channel that a server has opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Channel {
    pub(super) id: u32,
    pub(super) token: u32,
}

/// Bytes that are written.
#[derive(Default)]
struct Writer(Vec<u8>);

impl Writer {
    fn u32(&mut self, value: u32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.u32(u32::try_from(text.len()).unwrap_or(0));
        self.0.extend_from_slice(text.as_bytes());
    }

    /// A text, a byte string or a list that is not there.
    fn null(&mut self) {
        self.u32(u32::MAX);
    }

    /// The number of a type, in the form of four bytes.
    fn type_id(&mut self, number: u16) {
        self.0.extend_from_slice(&[1, 0]);
        self.0.extend_from_slice(&number.to_le_bytes());
    }

    /// The head of a request: no session, no time, a handle, no diagnostics.
    fn request_head(&mut self, handle: u32) {
        self.0.extend_from_slice(&[0, 0]);
        self.0.extend_from_slice(&[0; 8]);
        self.u32(handle);
        self.u32(0);
        self.null();
        self.u32(3000);
        self.0.extend_from_slice(&[0, 0, 0]);
    }

    fn message(kind: [u8; 4], body: &Self) -> Vec<u8> {
        let mut bytes = kind.to_vec();
        let length = u32::try_from(body.0.len() + 8).unwrap_or(0);
        bytes.extend_from_slice(&length.to_le_bytes());
        bytes.extend_from_slice(&body.0);
        bytes
    }
}

pub(super) fn hello(url: &str) -> Vec<u8> {
    let mut body = Writer::default();
    for value in [0, 65_536, 65_536, 0, 0] {
        body.u32(value);
    }
    body.text(url);
    Writer::message(*b"HELF", &body)
}

pub(super) fn open() -> Vec<u8> {
    let mut body = Writer::default();
    body.u32(0);
    body.text(POLICY_NONE);
    body.null();
    body.null();
    body.u32(1);
    body.u32(1);
    body.type_id(OPEN_REQUEST);
    body.request_head(1);
    // Protocol version 0, a new token, security mode None, no nonce, for one minute.
    body.u32(0);
    body.u32(0);
    body.u32(1);
    body.null();
    body.u32(60_000);
    Writer::message(*b"OPNF", &body)
}

pub(super) fn get_endpoints(channel: Channel, url: &str) -> Vec<u8> {
    let mut body = Writer::default();
    body.u32(channel.id);
    body.u32(channel.token);
    body.u32(2);
    body.u32(2);
    body.type_id(ENDPOINTS_REQUEST);
    body.request_head(2);
    body.text(url);
    body.null();
    body.null();
    Writer::message(*b"MSGF", &body)
}

/// Bytes that are read; every step may find too few.
struct Reader<'a>(&'a [u8]);

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let taken = self.0.get(..count)?;
        self.0 = &self.0[count..];
        Some(taken)
    }

    fn u8(&mut self) -> Option<u8> {
        self.take(1).map(|bytes| bytes[0])
    }

    fn u16(&mut self) -> Option<u16> {
        Some(u16::from_le_bytes(self.take(2)?.try_into().ok()?))
    }

    fn u32(&mut self) -> Option<u32> {
        Some(u32::from_le_bytes(self.take(4)?.try_into().ok()?))
    }

    /// A text or a byte string; one that is not there is empty.
    fn bytes(&mut self) -> Option<&'a [u8]> {
        match i32::from_le_bytes(self.take(4)?.try_into().ok()?) {
            -1 => Some(&[]),
            length => self.take(usize::try_from(length).ok()?),
        }
    }

    fn text(&mut self) -> Option<String> {
        Some(clean(&String::from_utf8_lossy(self.bytes()?)))
    }

    fn localized(&mut self) -> Option<String> {
        let mask = self.u8()?;
        if mask & 1 != 0 {
            self.bytes()?;
        }
        if mask & 2 != 0 {
            self.text()
        } else {
            Some(String::new())
        }
    }

    fn count(&mut self) -> Option<i32> {
        let count = i32::from_le_bytes(self.take(4)?.try_into().ok()?);
        (count <= MOST).then_some(count)
    }

    fn texts(&mut self) -> Option<()> {
        for _ in 0..self.count()? {
            self.bytes()?;
        }
        Some(())
    }

    /// The number of a type in the namespace of the standard, in the forms of two and four bytes and of a number.
    fn type_id(&mut self) -> Option<u32> {
        match self.u8()? {
            0 => self.u8().map(u32::from),
            1 => {
                self.u8()?;
                self.u16().map(u32::from)
            }
            2 => {
                self.u16()?;
                self.u32()
            }
            _ => None,
        }
    }

    /// The head of an answer; `None` where the service failed or says more than is needed here.
    fn response_head(&mut self, expected: u16) -> Option<()> {
        if self.type_id()? != u32::from(expected) {
            return None;
        }
        self.take(8)?;
        self.u32()?;
        let good = self.u32()? == 0;
        let no_diagnostics = self.u8()? == 0;
        self.texts()?;
        self.type_id()?;
        let no_body = self.u8()? == 0;
        (good && no_diagnostics && no_body).then_some(())
    }
}

/// The channel of the answer to [`open`], behind its head of eight bytes.
pub(super) fn parse_opened(body: &[u8]) -> Option<Channel> {
    let mut read = Reader(body);
    read.u32()?;
    for _ in 0..3 {
        read.bytes()?;
    }
    read.u32()?;
    read.u32()?;
    read.response_head(OPEN_RESPONSE)?;
    read.u32()?;
    Some(Channel {
        id: read.u32()?,
        token: read.u32()?,
    })
}

/// The answer to the question for the endpoints, behind the head of eight bytes of its message. `None`: it is none, or there
/// is no endpoint.
pub fn parse_endpoints(body: &[u8]) -> Option<Endpoint> {
    let mut read = Reader(body);
    for _ in 0..4 {
        read.u32()?;
    }
    read.response_head(ENDPOINTS_RESPONSE)?;
    let count = read.count()?;
    let mut found: Option<Endpoint> = None;
    for _ in 0..count {
        read.bytes()?;
        // The application: its URI, product, name, type, gateway, profile and addresses.
        read.bytes()?;
        let product = read.text()?;
        let name = read.localized()?;
        read.u32()?;
        read.bytes()?;
        read.bytes()?;
        read.texts()?;
        // The certificate, the mode and the policy.
        read.bytes()?;
        read.u32()?;
        let policy = read.text()?;
        let policy = policy.rsplit('#').next().unwrap_or_default().to_owned();
        // The ways to log in, the transport and the level.
        for _ in 0..read.count()? {
            read.bytes()?;
            read.u32()?;
            for _ in 0..3 {
                read.bytes()?;
            }
        }
        read.bytes()?;
        read.u8()?;
        let endpoint = found.get_or_insert_with(|| Endpoint {
            product,
            name,
            policies: Vec::new(),
        });
        if !policy.is_empty() && !endpoint.policies.contains(&policy) {
            endpoint.policies.push(policy);
        }
    }
    found
}
