//! A plain client: one request out, its answer in, before a deadline.

use std::{
    io::{self, Read as _, Write as _},
    net::{TcpStream, ToSocketAddrs},
    time::{Duration, Instant},
};

use super::{
    codec::{Cotp, Message, Write, connect_frame, frame_length, frame_of, parse_frame},
    error::S7Error,
    item::{Item, LONGEST_BLOCK, MOST_ITEMS},
};

/// The longest message that this client asks for.
const LONGEST: u16 = 960;
/// What a message needs besides its items and values.
const HEAD: usize = 14;

/// Where in a control a connection goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Target {
    /// The rack, 0 to 7.
    pub rack: u8,
    /// The slot, 0 to 31.
    pub slot: u8,
}

impl Target {
    /// The PLC of an 840D sl: rack 0, slot 2. Not proven.
    pub const PLC: Self = Self { rack: 0, slot: 2 };
    /// The NCK of an 840D sl: rack 0, slot 4. Not proven.
    pub const NCK: Self = Self { rack: 0, slot: 4 };

    fn address(self) -> u16 {
        // A connection like a programming device's.
        0x0100 | u16::from(self.rack & 7) << 5 | u16::from(self.slot & 31)
    }
}

/// An open connection to a control.
#[derive(Debug)]
pub struct Client {
    stream: Option<TcpStream>,
    at_most: Duration,
    reference: u16,
    longest: usize,
}

impl Client {
    /// Connects to `host` (`HOST:102`) and agrees on the length of messages; every request may take `at_most`.
    ///
    /// # Errors
    /// No connection, no answer in time, another answer than that of S7.
    pub fn connect(
        host: impl ToSocketAddrs,
        target: Target,
        at_most: Duration,
    ) -> Result<Self, S7Error> {
        let deadline = Instant::now() + at_most;
        let io = |what| move |source| S7Error::Io { what, source };
        let mut addresses = host.to_socket_addrs().map_err(io("address"))?;
        let address = addresses.next().ok_or(S7Error::Closed)?;
        let stream = TcpStream::connect_timeout(&address, at_most.max(Duration::from_millis(1)))
            .map_err(io("connecting"))?;
        stream.set_nodelay(true).map_err(io("connecting"))?;
        let mut client = Self {
            stream: Some(stream),
            at_most,
            reference: 0,
            longest: usize::from(LONGEST),
        };
        let mut answer = Vec::new();
        client.exchange_bytes(&connect_frame(target.address()), &mut answer, deadline)?;
        if parse_frame(&answer)? != Cotp::Confirm {
            return Err(S7Error::Frame("another answer than to a connection"));
        }
        let reference = client.next();
        let setup = Message::Setup {
            reference,
            longest: LONGEST,
            is_answer: false,
        };
        match client.exchange(&setup)? {
            Message::Setup { longest, .. } if longest >= 64 => {
                client.longest = usize::from(longest.min(LONGEST));
                Ok(client)
            }
            _ => Err(S7Error::Frame("another answer than to a setup")),
        }
    }

    /// Reads items, each with its bytes.
    ///
    /// # Errors
    /// More than [`MOST_ITEMS`], or than a message can carry; the first item that the control refuses; others end the
    /// connection.
    pub fn read(&mut self, items: &[Item]) -> Result<Vec<Vec<u8>>, S7Error> {
        let answer: usize = items
            .iter()
            .map(|item| 5 + usize::from(length(*item)))
            .sum();
        self.check(items.iter(), answer)?;
        let reference = self.next();
        let request = Message::Read {
            reference,
            items: items.to_vec(),
        };
        let Message::Values { values, .. } = self.exchange(&request)? else {
            return self.broken("another answer than to a reading");
        };
        if values.len() != items.len() {
            return self.broken("another number of values than of items");
        }
        let of_item = |(place, value): (usize, Result<_, _>)| {
            value.map_err(|code| S7Error::Item { place, code })
        };
        let values: Vec<Vec<u8>> = values
            .into_iter()
            .enumerate()
            .map(of_item)
            .collect::<Result<_, _>>()?;
        for (item, bytes) in items.iter().zip(&values) {
            if matches!(item, Item::Block { count, .. } if bytes.len() != usize::from(*count)) {
                return self.broken("another number of bytes than were asked for");
            }
        }
        Ok(values)
    }

    /// Writes items.
    ///
    /// # Errors
    /// As [`Client::read`]; items before one that is refused may have been written.
    pub fn write(&mut self, writes: &[Write]) -> Result<(), S7Error> {
        let bytes: usize = writes.iter().map(|write| 5 + write.bytes.len()).sum();
        self.check(writes.iter().map(|write| &write.item), bytes)?;
        for write in writes {
            let count = write.bytes.len();
            if matches!(write.item, Item::Block { count: stated, .. } if count != usize::from(stated))
            {
                return Err(S7Error::Request {
                    found: format!("found {count} bytes for an item"),
                    expected: "as many as it has".to_owned(),
                });
            }
        }
        let reference = self.next();
        let request = Message::Write {
            reference,
            writes: writes.to_vec(),
        };
        let Message::Written { codes, .. } = self.exchange(&request)? else {
            return self.broken("another answer than to a writing");
        };
        if codes.len() != writes.len() {
            return self.broken("another number of codes than of items");
        }
        let refused = codes
            .into_iter()
            .enumerate()
            .find(|(_, code)| code.0 != 0xff);
        refused.map_or(Ok(()), |(place, code)| Err(S7Error::Item { place, code }))
    }

    fn check<'a>(
        &self,
        items: impl ExactSizeIterator<Item = &'a Item>,
        of_values: usize,
    ) -> Result<(), S7Error> {
        let count = items.len();
        for item in items {
            item.check()?;
        }
        let parameters = 2 + 12 * count;
        if (1..=MOST_ITEMS).contains(&count) && HEAD + parameters + of_values <= self.longest {
            return Ok(());
        }
        Err(S7Error::Request {
            found: format!("found {count} items"),
            expected: format!("1 to {MOST_ITEMS}, in messages of {} bytes", self.longest),
        })
    }

    fn next(&mut self) -> u16 {
        self.reference = self.reference.wrapping_add(1);
        self.reference
    }

    fn broken<T>(&mut self, what: &'static str) -> Result<T, S7Error> {
        self.stream = None;
        Err(S7Error::Frame(what))
    }

    /// One request and its answer. Every error but a refusal ends the connection: a late answer would be taken for the next.
    fn exchange(&mut self, request: &Message) -> Result<Message, S7Error> {
        let deadline = Instant::now() + self.at_most;
        let mut bytes = Vec::new();
        self.exchange_bytes(&frame_of(request), &mut bytes, deadline)?;
        let answer = match parse_frame(&bytes).and_then(|frame| match frame {
            Cotp::Data(data) => Message::parse(data),
            _ => Err(S7Error::Frame("another frame than a message")),
        }) {
            Ok(answer) if answer.reference() == request.reference() => answer,
            Ok(_) => return self.broken("the answer to another request"),
            Err(error) => {
                self.stream = None;
                return Err(error);
            }
        };
        match answer {
            Message::Refused { class, code, .. } => Err(S7Error::Refused { class, code }),
            answer => Ok(answer),
        }
    }

    fn exchange_bytes(
        &mut self,
        request: &[u8],
        answer: &mut Vec<u8>,
        deadline: Instant,
    ) -> Result<(), S7Error> {
        // Given up unless everything goes well.
        let mut stream = self.stream.take().ok_or(S7Error::Closed)?;
        let sent = self.until(&stream, deadline).and_then(|()| {
            stream
                .write_all(request)
                .map_err(|source| self.failed("sending", source))
        });
        sent?;
        answer.resize(4, 0);
        self.fill(&mut stream, answer, 0, deadline)?;
        let head = answer.first_chunk().ok_or(S7Error::Short("a frame"))?;
        let length = frame_length(*head)?;
        answer.resize(length, 0);
        self.fill(&mut stream, answer, 4, deadline)?;
        self.stream = Some(stream);
        Ok(())
    }

    fn fill(
        &self,
        stream: &mut TcpStream,
        into: &mut [u8],
        mut have: usize,
        deadline: Instant,
    ) -> Result<(), S7Error> {
        while have < into.len() {
            self.until(stream, deadline)?;
            match stream.read(&mut into[have..]) {
                Ok(0) => {
                    let source = io::ErrorKind::UnexpectedEof.into();
                    return Err(S7Error::Io {
                        what: "receiving",
                        source,
                    });
                }
                Ok(count) => have += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(source) => return Err(self.failed("receiving", source)),
            }
        }
        Ok(())
    }

    /// Lets the next call take until the deadline.
    fn until(&self, stream: &TcpStream, deadline: Instant) -> Result<(), S7Error> {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Err(S7Error::TimedOut(self.at_most));
        }
        let set = stream
            .set_read_timeout(Some(left))
            .and_then(|()| stream.set_write_timeout(Some(left)));
        set.map_err(|source| S7Error::Io {
            what: "deadline",
            source,
        })
    }

    fn failed(&self, what: &'static str, source: io::Error) -> S7Error {
        match source.kind() {
            io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut => S7Error::TimedOut(self.at_most),
            _ => S7Error::Io { what, source },
        }
    }
}

/// How many bytes an item has at the most.
fn length(item: Item) -> u16 {
    match item {
        Item::Block { count, .. } => count,
        // What a line has depends on the variable; a number has eight bytes.
        Item::Nck(variable) => (u16::from(variable.lines) * 8).min(LONGEST_BLOCK),
    }
}
