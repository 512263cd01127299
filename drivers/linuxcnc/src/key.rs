//! The key shared by gateway and bridge, and the message authentication code.

use std::{fmt, path::Path};

use siphasher::sip::SipHasher24;
use volcomp_document::{PrivateError, private};

/// Length of a message authentication code, bytes.
pub(crate) const MAC: usize = 8;

/// Key shared by the gateway and the bridge. It authenticates every datagram in both directions.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Key([u8; 16]);

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeyError {
    /// The file cannot be read, or is readable by others.
    #[error(transparent)]
    Private(#[from] PrivateError),
    #[error("{}: found another text, expected 32 hexadecimal digits", .0.display())]
    Malformed(std::path::PathBuf),
}

impl Key {
    #[must_use]
    pub const fn new(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// Reads a key from a file of mode 600. The file contains 32 hexadecimal digits, as `openssl rand -hex 16` prints
    /// them.
    ///
    /// # Errors
    /// A file that cannot be read, is readable by others, or does not contain a key.
    pub fn read(file: &Path) -> Result<Self, KeyError> {
        let text = private::read(file)?;
        Self::parse(&text).ok_or_else(|| KeyError::Malformed(file.to_owned()))
    }

    /// Parses 32 hexadecimal digits. Blanks and line ends may follow them.
    fn parse(text: &str) -> Option<Self> {
        let digits = text.trim_end_matches([' ', '\t', '\r', '\n']).as_bytes();
        let (pairs, []) = digits.as_chunks::<2>() else {
            return None;
        };
        let mut bytes = [0; 16];
        if pairs.len() != bytes.len() {
            return None;
        }
        for (byte, pair) in bytes.iter_mut().zip(pairs) {
            let [high, low] = pair.map(|digit| char::from(digit).to_digit(16));
            *byte = u8::try_from(16 * high? + low?).ok()?;
        }
        Some(Self(bytes))
    }

    /// Message authentication code of these bytes: SipHash-2-4 with 64 bits.
    #[must_use]
    pub fn mac(&self, bytes: &[u8]) -> [u8; 8] {
        SipHasher24::new_with_key(&self.0).hash(bytes).to_le_bytes()
    }
}

/// Never prints the key.
impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key")
    }
}
