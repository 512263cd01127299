//! What can go wrong.

use std::{fmt, io, time::Duration};

/// Why a request failed. After every error but [`S7Error::Refused`] and [`S7Error::Item`] the connection is given up.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum S7Error {
    /// The bytes are not what the protocol allows.
    #[error("broken frame: {0}")]
    Frame(&'static str),
    /// Too few bytes, or a length that does not fit.
    #[error("frame cut short at {0}")]
    Short(&'static str),
    /// The connection cannot be made, or is lost.
    #[error("{what}: {source}")]
    Io {
        /// What was done.
        what: &'static str,
        /// Why it failed.
        source: io::Error,
    },
    /// No answer before the deadline.
    #[error("no answer within {} ms, so the connection is given up", .0.as_secs_f64() * 1e3)]
    TimedOut(Duration),
    /// The connection was given up after an error before.
    #[error("the connection was given up")]
    Closed,
    /// The control refuses the request as a whole.
    #[error("refused with error class {class:#04x}, code {code:#04x}")]
    Refused {
        /// The error class of the header.
        class: u8,
        /// The error code of the header.
        code: u8,
    },
    /// The control refuses one item.
    #[error("item {place}: {code}")]
    Item {
        /// The place of the item in the request, from 0.
        place: usize,
        /// Why it refuses.
        code: ReturnCode,
    },
    /// A request that cannot be sent.
    #[error("{found}, expected {expected}")]
    Request {
        /// What was asked for.
        found: String,
        /// What can be.
        expected: String,
    },
}

impl S7Error {
    /// Whether the connection goes on.
    pub fn is_refusal(&self) -> bool {
        matches!(
            self,
            Self::Refused { .. } | Self::Item { .. } | Self::Request { .. }
        )
    }
}

/// The return code of an item.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReturnCode(pub u8);

impl ReturnCode {
    /// The item was read or written.
    pub const GOOD: Self = Self(0xff);
    /// There is no such address.
    pub const ADDRESS: Self = Self(0x05);
    /// There is no such block or variable.
    pub const NO_OBJECT: Self = Self(0x0a);
    /// Data of another type or length than the item.
    pub const TYPE: Self = Self(0x06);
}

impl fmt::Display for ReturnCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = match self.0 {
            0xff => "good",
            0x01 => "hardware fault",
            0x03 => "access is not allowed",
            0x05 => "there is no such address",
            0x06 => "the type of the data is not supported",
            0x07 => "the type of the data does not fit",
            0x0a => "there is no such block or variable",
            _ => "refused",
        };
        write!(f, "{words} (return code {:#04x})", self.0)
    }
}
