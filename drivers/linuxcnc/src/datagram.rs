//! What states and commands have in common: how a datagram begins and ends, and its numbers.

use volcomp_port::MOST_WORDS;
use volcomp_vocabulary::{AxisName, MAX_AXES};

use crate::{Key, VERSION, key::MAC};

/// Why a datagram cannot be read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum Broken {
    /// There are too few or too many bytes.
    #[error("found {found} bytes, expected {expected}")]
    Length {
        /// The number of bytes that were found.
        found: usize,
        /// The number that was expected.
        expected: usize,
    },
    /// The datagram begins with other bytes.
    #[error("found another beginning than that of a datagram of this protocol, VCLS or VCLF")]
    Magic,
    /// The other side speaks another version of the protocol.
    #[error("found version {found} of the protocol, expected {VERSION}")]
    Version {
        /// The version that was found.
        found: u8,
    },
    /// The message authentication code is not that of our key.
    #[error(
        "found another message authentication code than that of our key: the other side has another key, or bytes were changed on the way"
    )]
    Mac,
    /// The number of axes is beyond the largest.
    #[error("found {found} axes, expected {MAX_AXES} at the most")]
    Axes {
        /// The number that was found.
        found: usize,
    },
    /// The number of words is beyond the largest.
    #[error("found {found} words, expected {MOST_WORDS} at the most")]
    Words {
        /// The number that was found.
        found: usize,
    },
    /// A letter is no axis, or comes twice.
    #[error("found the letter {:?}, expected those of axes, each once", char::from(*found))]
    Letter {
        /// The byte that was found.
        found: u8,
    },
    /// A position or velocity is not finite, or the size of a count is zero.
    #[error(
        "axis {axis}: found a position or velocity that is not finite, or a count of size 0, expected numbers and a size of 1 or more"
    )]
    Number {
        /// The axis whose numbers these are.
        axis: AxisName,
    },
    /// The content is of a kind that there is not.
    #[error("found the kind {found} of content, expected 0 (states are wanted) or 1 (a frame)")]
    Kind {
        /// The number that was found.
        found: u16,
    },
}

/// The datagram without its code, where it begins with these four bytes, is of our version and our key, and has at least its head.
pub(crate) fn opened<'a>(
    bytes: &'a [u8],
    magic: [u8; 4],
    head: usize,
    key: &Key,
) -> Result<&'a [u8], Broken> {
    if !bytes.starts_with(&magic) {
        return Err(Broken::Magic);
    }
    if let Some(&found) = bytes.get(4).filter(|version| **version != VERSION) {
        return Err(Broken::Version { found });
    }
    let short = Broken::Length {
        found: bytes.len(),
        expected: head + MAC,
    };
    let (body, code) = bytes.split_last_chunk::<MAC>().ok_or(short)?;
    if key.mac(body) != *code {
        return Err(Broken::Mac);
    }
    if body.len() < head {
        return Err(short);
    }
    Ok(body)
}

/// Appends bytes to a datagram of fixed room.
pub(crate) struct Writer<'a> {
    bytes: &'a mut [u8],
    length: usize,
}

impl<'a> Writer<'a> {
    pub(crate) fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, length: 0 }
    }

    /// Appends these bytes; the room of every datagram is that of its largest content.
    pub(crate) fn put(&mut self, more: &[u8]) {
        let end = self.length + more.len();
        if let Some(room) = self.bytes.get_mut(self.length..end) {
            room.copy_from_slice(more);
            self.length = end;
        }
    }

    /// Appends the code of this key. How many bytes there are.
    pub(crate) fn seal(mut self, key: &Key) -> usize {
        let code = key.mac(&self.bytes[..self.length]);
        self.put(&code);
        self.length
    }
}

/// Takes bytes from a datagram whose length was checked.
pub(crate) struct Reader<'a>(pub(crate) &'a [u8]);

impl Reader<'_> {
    /// The next bytes; zeros where there are none left.
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
