//! The key that gateway and bridge share, and the code that it gives to a datagram.

use std::{fmt, path::Path};

use siphasher::sip::SipHasher24;
use volcomp_document::{PrivateError, private};

/// The bytes of a message authentication code.
pub(crate) const MAC: usize = 8;

/// The key that the gateway and the bridge share: with it both write and check the message authentication code of every datagram.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Key([u8; 16]);

/// Why a key cannot be read from a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeyError {
    /// The file cannot be read, or others may read it.
    #[error(transparent)]
    Private(#[from] PrivateError),
    /// The file holds something else.
    #[error("{}: expected 32 hexadecimal digits and nothing else", .0.display())]
    Malformed(std::path::PathBuf),
}

impl Key {
    /// A key of these bytes.
    #[must_use]
    pub const fn new(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }

    /// Reads a key from a file of mode 600: 32 hexadecimal digits, as `openssl rand -hex 16` prints them.
    ///
    /// # Errors
    /// A file that cannot be read, that others may read, or that holds something else.
    pub fn read(file: &Path) -> Result<Self, KeyError> {
        let text = private::read(file)?;
        Self::parse(&text).ok_or_else(|| KeyError::Malformed(file.to_owned()))
    }

    /// The bytes of 32 hexadecimal digits, with blanks after them.
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

    /// The message authentication code of these bytes: SipHash-2-4 with 64 bits.
    #[must_use]
    pub fn mac(&self, bytes: &[u8]) -> [u8; 8] {
        SipHasher24::new_with_key(&self.0).hash(bytes).to_le_bytes()
    }
}

/// Nothing of the key.
impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key")
    }
}
