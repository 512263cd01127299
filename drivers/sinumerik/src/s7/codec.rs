//! Frames and messages: bytes to data and back. Nothing here panics or reads beyond what it was given, whatever the bytes.

use super::{
    error::{ReturnCode, S7Error},
    item::{Item, MOST_ITEMS},
};

/// The longest frame that is taken, bytes.
pub(crate) const LONGEST: usize = 8192;
const JOB: u8 = 1;
const ANSWER: u8 = 3;
const SETUP: u8 = 0xf0;
const READ: u8 = 0x04;
const WRITE: u8 = 0x05;
/// How the length of data is counted: in bits, or in bytes.
const IN_BITS: [u8; 3] = [0x03, 0x04, 0x05];
/// Bytes of a data block.
const BLOCK_DATA: u8 = 0x04;
/// A value of the NCK.
const NCK_DATA: u8 = 0x0f;

/// What a frame carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cotp<'a> {
    /// A connection is asked for, to this address within the control.
    Connect {
        /// Kind of the connection, rack and slot.
        to: u16,
    },
    /// The connection is there.
    Confirm,
    /// A message.
    Data(&'a [u8]),
}

/// One item to be written with its bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Write {
    /// The variable that is written.
    pub item: Item,
    /// The bytes of its new value.
    pub bytes: Vec<u8>,
}

/// A message.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Message {
    /// How long messages may be is agreed: a request or an answer.
    Setup {
        /// Its number, which the answer repeats.
        reference: u16,
        /// The longest message, bytes.
        longest: u16,
        /// Whether it is the answer.
        is_answer: bool,
    },
    /// Items are asked for.
    Read {
        /// Its number, which the answer repeats.
        reference: u16,
        /// The items.
        items: Vec<Item>,
    },
    /// Items are to be written.
    Write {
        /// Its number, which the answer repeats.
        reference: u16,
        /// The items with their bytes.
        writes: Vec<Write>,
    },
    /// The answer to a reading: for each item its bytes, or why there are none.
    Values {
        /// The number of the request.
        reference: u16,
        /// The values.
        values: Vec<Result<Vec<u8>, ReturnCode>>,
        /// Whether they are of the NCK, item by item; only for making the answer.
        of_nck: Vec<bool>,
    },
    /// The answer to a writing: the code of each item.
    Written {
        /// The number of the request.
        reference: u16,
        /// The codes.
        codes: Vec<ReturnCode>,
    },
    /// The request was refused as a whole.
    Refused {
        /// The number of the request.
        reference: u16,
        /// The error class.
        class: u8,
        /// The error code.
        code: u8,
    },
}

/// How long the frame is that begins with these four bytes.
///
/// # Errors
/// They do not begin a frame, or one that is longer than any.
pub fn frame_length(head: [u8; 4]) -> Result<usize, S7Error> {
    let [version, _, high, low] = head;
    let length = usize::from(u16::from_be_bytes([high, low]));
    if version != 3 {
        return Err(S7Error::Frame("no TPKT of version 3"));
    }
    if !(7..=LONGEST).contains(&length) {
        return Err(S7Error::Frame("a length that no frame has"));
    }
    Ok(length)
}

fn framed(content: &[u8]) -> Vec<u8> {
    let length = u16::try_from(content.len() + 4).unwrap_or(u16::MAX);
    let [high, low] = length.to_be_bytes();
    let mut frame = vec![3, 0, high, low];
    frame.extend(content);
    frame
}

/// The frame that asks for a connection to this address within the control.
pub fn connect_frame(to: u16) -> Vec<u8> {
    let [high, low] = to.to_be_bytes();
    framed(&[
        17, 0xe0, 0, 0, 0, 1, 0, 0xc0, 1, 0x0a, 0xc1, 2, 1, 0, 0xc2, 2, high, low,
    ])
}

/// The frame that says that the connection is there.
pub fn confirm_frame() -> Vec<u8> {
    framed(&[
        17, 0xd0, 0, 1, 0, 6, 0, 0xc0, 1, 0x0a, 0xc1, 2, 1, 0, 0xc2, 2, 1, 2,
    ])
}

/// The frame of a message.
pub fn frame_of(message: &Message) -> Vec<u8> {
    let mut content = vec![2, 0xf0, 0x80];
    message.put(&mut content);
    framed(&content)
}

/// Takes a whole frame apart.
///
/// # Errors
/// Bytes that are no frame.
pub fn parse_frame(bytes: &[u8]) -> Result<Cotp<'_>, S7Error> {
    let (head, rest) = bytes.split_first_chunk().ok_or(S7Error::Short("a frame"))?;
    if frame_length(*head)? != bytes.len() {
        return Err(S7Error::Short("a frame"));
    }
    let (&length, rest) = rest.split_first().ok_or(S7Error::Short("COTP"))?;
    let (cotp, data) = rest
        .split_at_checked(usize::from(length))
        .ok_or(S7Error::Short("COTP"))?;
    match cotp.first() {
        Some(0xe0) => Ok(Cotp::Connect { to: called(cotp)? }),
        Some(0xd0) => Ok(Cotp::Confirm),
        Some(0xf0) if cotp.get(1).is_some_and(|end| end & 0x80 != 0) => Ok(Cotp::Data(data)),
        Some(0xf0) => Err(S7Error::Frame("a message in several frames")),
        _ => Err(S7Error::Frame("another kind of COTP")),
    }
}

/// The address within the control of a request for a connection.
fn called(cotp: &[u8]) -> Result<u16, S7Error> {
    let mut rest = cotp.get(6..).ok_or(S7Error::Short("COTP"))?;
    while let Some((&[key, length], after)) = rest.split_first_chunk() {
        let (value, next) = after
            .split_at_checked(usize::from(length))
            .ok_or(S7Error::Short("COTP"))?;
        if let (0xc2, &[high, low]) = (key, value) {
            return Ok(u16::from_be_bytes([high, low]));
        }
        rest = next;
    }
    Err(S7Error::Frame("a connection to nowhere"))
}

impl Message {
    /// Its number, which request and answer share.
    pub fn reference(&self) -> u16 {
        match self {
            Self::Setup { reference, .. }
            | Self::Read { reference, .. }
            | Self::Write { reference, .. }
            | Self::Values { reference, .. }
            | Self::Written { reference, .. }
            | Self::Refused { reference, .. } => *reference,
        }
    }

    /// Appends it.
    fn put(&self, into: &mut Vec<u8>) {
        let (mut parameters, mut data) = (Vec::new(), Vec::new());
        let mut error = None;
        let count = |items: usize| u8::try_from(items).unwrap_or(u8::MAX);
        match self {
            Self::Setup {
                longest, is_answer, ..
            } => {
                parameters.extend([SETUP, 0, 0, 1, 0, 1]);
                parameters.extend(longest.to_be_bytes());
                error = is_answer.then_some([0, 0]);
            }
            Self::Read { items, .. } => {
                parameters.extend([READ, count(items.len())]);
                for item in items {
                    item.put(&mut parameters);
                }
            }
            Self::Write { writes, .. } => {
                parameters.extend([WRITE, count(writes.len())]);
                for (place, write) in writes.iter().enumerate() {
                    write.item.put(&mut parameters);
                    let of_nck = matches!(write.item, Item::Nck(_));
                    put_data(
                        &mut data,
                        0,
                        of_nck,
                        &write.bytes,
                        place + 1 == writes.len(),
                    );
                }
            }
            Self::Values { values, of_nck, .. } => {
                error = Some([0, 0]);
                parameters.extend([READ, count(values.len())]);
                for (place, value) in values.iter().enumerate() {
                    let is_last = place + 1 == values.len();
                    match value {
                        Ok(bytes) => {
                            let of_nck = of_nck.get(place).copied().unwrap_or(false);
                            put_data(&mut data, ReturnCode::GOOD.0, of_nck, bytes, is_last);
                        }
                        Err(code) => data.extend([code.0, 0, 0, 0]),
                    }
                }
            }
            Self::Written { codes, .. } => {
                error = Some([0, 0]);
                parameters.extend([WRITE, count(codes.len())]);
                data.extend(codes.iter().map(|code| code.0));
            }
            Self::Refused { class, code, .. } => error = Some([*class, *code]),
        }
        let length = |bytes: &[u8]| u16::try_from(bytes.len()).unwrap_or(u16::MAX).to_be_bytes();
        into.extend([0x32, if error.is_some() { ANSWER } else { JOB }, 0, 0]);
        into.extend(self.reference().to_be_bytes());
        into.extend(length(&parameters));
        into.extend(length(&data));
        into.extend(error.into_iter().flatten());
        into.extend(parameters);
        into.extend(data);
    }

    /// Takes a message apart.
    ///
    /// # Errors
    /// Bytes that are none.
    pub fn parse(bytes: &[u8]) -> Result<Self, S7Error> {
        let short = || S7Error::Short("a message");
        let (&[protocol, kind, _, _, r1, r0, p1, p0, d1, d0], rest) =
            bytes.split_first_chunk().ok_or_else(short)?;
        if protocol != 0x32 {
            return Err(S7Error::Frame("another protocol than S7"));
        }
        let reference = u16::from_be_bytes([r1, r0]);
        let (error, rest) = match kind {
            JOB => (None, rest),
            ANSWER => {
                let (error, rest) = rest.split_first_chunk::<2>().ok_or_else(short)?;
                (Some(*error), rest)
            }
            _ => return Err(S7Error::Frame("another kind of message")),
        };
        let parameters = usize::from(u16::from_be_bytes([p1, p0]));
        let data = usize::from(u16::from_be_bytes([d1, d0]));
        if rest.len() != parameters + data {
            return Err(short());
        }
        let (parameters, data) = rest.split_at(parameters);
        if let Some([class, code]) = error.filter(|error| *error != [0, 0]) {
            return Ok(Self::Refused {
                reference,
                class,
                code,
            });
        }
        let is_answer = error.is_some();
        match *parameters {
            [SETUP, _, _, _, _, _, high, low] if data.is_empty() => Ok(Self::Setup {
                reference,
                longest: u16::from_be_bytes([high, low]),
                is_answer,
            }),
            [READ, count, ref items @ ..] if !is_answer && data.is_empty() => Ok(Self::Read {
                reference,
                items: parse_items(items, count)?,
            }),
            [WRITE, count, ref items @ ..] if !is_answer => {
                let items = parse_items(items, count)?;
                let values = parse_data(data, items.len())?.into_iter();
                let writes = items.into_iter().zip(values).map(|(item, (_, value))| {
                    let (_, bytes) = value;
                    Write { item, bytes }
                });
                Ok(Self::Write {
                    reference,
                    writes: writes.collect(),
                })
            }
            [READ, count] if is_answer => {
                let values = parse_data(data, usize::from(count))?;
                Ok(Self::Values {
                    reference,
                    of_nck: values
                        .iter()
                        .map(|(_, (kind, _))| *kind == NCK_DATA)
                        .collect(),
                    values: values
                        .into_iter()
                        .map(|(code, (_, bytes))| match code {
                            ReturnCode::GOOD => Ok(bytes),
                            code => Err(code),
                        })
                        .collect(),
                })
            }
            [WRITE, count] if is_answer && data.len() == usize::from(count) => Ok(Self::Written {
                reference,
                codes: data.iter().copied().map(ReturnCode).collect(),
            }),
            _ => Err(S7Error::Frame("another function, or parts that do not fit")),
        }
    }
}

/// Appends one value; every one but the last is filled up to whole words.
fn put_data(into: &mut Vec<u8>, code: u8, of_nck: bool, bytes: &[u8], is_last: bool) {
    let kind = if of_nck { NCK_DATA } else { BLOCK_DATA };
    let length = if of_nck { bytes.len() } else { bytes.len() * 8 };
    into.extend([code, kind]);
    into.extend(u16::try_from(length).unwrap_or(u16::MAX).to_be_bytes());
    into.extend(bytes);
    if !is_last && bytes.len() % 2 == 1 {
        into.push(0);
    }
}

type Datum = (ReturnCode, (u8, Vec<u8>));

fn parse_data(mut data: &[u8], count: usize) -> Result<Vec<Datum>, S7Error> {
    let short = || S7Error::Short("a value");
    if count > MOST_ITEMS {
        return Err(S7Error::Frame("more items than a message has"));
    }
    let mut values = Vec::with_capacity(count);
    for place in 0..count {
        let (&[code, kind, high, low], rest) = data.split_first_chunk().ok_or_else(short)?;
        let stated = usize::from(u16::from_be_bytes([high, low]));
        let length = if IN_BITS.contains(&kind) {
            stated.div_ceil(8)
        } else {
            stated
        };
        let (bytes, rest) = rest.split_at_checked(length).ok_or_else(short)?;
        values.push((ReturnCode(code), (kind, bytes.to_vec())));
        let is_filled = place + 1 < count && length % 2 == 1;
        data = if is_filled {
            rest.get(1..).ok_or_else(short)?
        } else {
            rest
        };
    }
    if !data.is_empty() {
        return Err(S7Error::Frame("bytes beyond the last value"));
    }
    Ok(values)
}

fn parse_items(mut bytes: &[u8], count: u8) -> Result<Vec<Item>, S7Error> {
    let count = usize::from(count);
    if count > MOST_ITEMS {
        return Err(S7Error::Frame("more items than a message has"));
    }
    let mut items = Vec::with_capacity(count);
    for _ in 0..count {
        let (item, rest) = Item::take(bytes)?;
        items.push(item);
        bytes = rest;
    }
    if !bytes.is_empty() {
        return Err(S7Error::Frame("bytes beyond the last item"));
    }
    Ok(items)
}
