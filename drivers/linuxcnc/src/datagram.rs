//! The common parts of states and commands: header, message authentication code and encoding of numbers.

use volcomp_port::MOST_WORDS;
use volcomp_vocabulary::{AxisName, MAX_AXES};

use crate::{Key, VERSION, key::MAC};

#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DatagramError {
    /// The length of the datagram does not match its content.
    #[error("found {found} bytes, expected {expected}")]
    Length {
        /// Length of the datagram, bytes.
        found: usize,
        /// Length that the content requires, bytes.
        expected: usize,
    },
    #[error("found other magic bytes than those of this protocol, VCLS or VCLF")]
    Magic,
    /// The sender uses another version of the protocol.
    #[error("found version {found} of the protocol, expected {VERSION}")]
    Version {
        /// Version of the protocol in the datagram.
        found: u8,
    },
    /// The message authentication code does not match the gateway's key.
    #[error(
        "found another message authentication code than that of our key: the other side has another key, or the datagram was modified"
    )]
    Mac,
    #[error("found {found} axes, expected at most {MAX_AXES}")]
    Axes {
        /// Number of axes in the datagram.
        found: usize,
    },
    #[error("found {found} words, expected at most {MOST_WORDS}")]
    Words {
        /// Number of words in the datagram.
        found: usize,
    },
    /// A letter is not an axis, or occurs twice.
    #[error("found the letter {:?}, expected those of axes, each once", char::from(*found))]
    Letter {
        /// The rejected byte.
        found: u8,
    },
    /// A position or velocity is not finite, or a count has the size zero.
    #[error(
        "axis {axis}: found a position or velocity that is not finite, or a count of size 0, expected numbers and a size of 1 or more"
    )]
    Number {
        /// Axis with the invalid position, velocity or count size.
        axis: AxisName,
    },
    #[error("found the kind {found} of content, expected 0 (request for states) or 1 (a frame)")]
    Kind {
        /// Unknown code of the kind of content.
        found: u16,
    },
}

/// Checks magic bytes, version, authentication code and minimum length of a datagram. Returns the datagram without the
/// authentication code.
pub(crate) fn opened<'a>(
    bytes: &'a [u8],
    magic: [u8; 4],
    head: usize,
    key: &Key,
) -> Result<&'a [u8], DatagramError> {
    if !bytes.starts_with(&magic) {
        return Err(DatagramError::Magic);
    }
    if let Some(&found) = bytes.get(4).filter(|version| **version != VERSION) {
        return Err(DatagramError::Version { found });
    }
    let short = DatagramError::Length { found: bytes.len(), expected: head + MAC };
    let (body, code) = bytes.split_last_chunk::<MAC>().ok_or(short)?;
    if key.mac(body) != *code {
        return Err(DatagramError::Mac);
    }
    if body.len() < head {
        return Err(short);
    }
    Ok(body)
}

pub(crate) struct Writer<'a> {
    bytes: &'a mut [u8],
    length: usize,
}

impl<'a> Writer<'a> {
    pub(crate) fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, length: 0 }
    }

    /// Appends bytes. The buffer has room for the largest content, so the bytes always fit.
    pub(crate) fn put(&mut self, more: &[u8]) {
        let end = self.length + more.len();
        if let Some(room) = self.bytes.get_mut(self.length..end) {
            room.copy_from_slice(more);
            self.length = end;
        }
    }

    /// Appends the authentication code. Returns the total length in bytes.
    pub(crate) fn seal(mut self, key: &Key) -> usize {
        let code = key.mac(&self.bytes[..self.length]);
        self.put(&code);
        self.length
    }
}

pub(crate) struct Reader<'a>(pub(crate) &'a [u8]);

impl Reader<'_> {
    /// Removes the next `N` bytes from the start and returns them. Returns zeros if fewer bytes are left.
    pub(crate) fn take<const N: usize>(&mut self) -> [u8; N] {
        let Some((head, rest)) = self.0.split_first_chunk::<N>() else {
            return [0; N];
        };
        self.0 = rest;
        *head
    }

    pub(crate) fn u8(&mut self) -> u8 {
        u8::from_le_bytes(self.take())
    }

    pub(crate) fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.take())
    }

    pub(crate) fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }
}
