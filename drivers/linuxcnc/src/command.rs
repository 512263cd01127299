use volcomp_port::{MOST_WORDS, Words};

use crate::{
    DatagramError, Key, VERSION,
    datagram::{Reader, Writer, opened},
    key::MAC,
};

const MAGIC: [u8; 4] = *b"VCLF";
const HEADER_BYTES: usize = 20;

/// Maximum size of a command, bytes.
pub const COMMAND_BYTES: usize = HEADER_BYTES + 2 * MOST_WORDS + MAC;

/// A command from a gateway to a bridge. For one second after a command, the bridge sends its states to the address of
/// the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command {
    /// Number of the machine, as set in the bridge.
    pub machine: u16,
    /// Run and sequence number of the state that the command answers; zeros before the first state. The bridge rejects
    /// a frame unless it answers a state of the last second. With zeros, a command can only request states.
    pub answers: [u32; 2],
    pub content: Content,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// Request that the bridge continues to send states. It contains no frame.
    Listen,
    /// Frame for the barrier. The frame has its own epoch, tick, owner, sequence and checksum.
    Frame(Words),
}

impl Command {
    /// Decodes a command from a datagram.
    ///
    /// # Errors
    /// A datagram that is not a command of this version and key.
    pub fn decode(bytes: &[u8], key: &Key) -> Result<Self, DatagramError> {
        let body = opened(bytes, MAGIC, HEADER_BYTES, key)?;
        let mut reader = Reader(&body[6..]);
        let machine = reader.u16();
        let answers = [reader.u32(), reader.u32()];
        let (kind, count) = (reader.u16(), usize::from(reader.u16()));
        if count > MOST_WORDS {
            return Err(DatagramError::Words { found: count });
        }
        let found = bytes.len();
        let expected = HEADER_BYTES + 2 * count + MAC;
        if found != expected {
            return Err(DatagramError::Length { found, expected });
        }
        let mut words = [0; MOST_WORDS];
        for word in &mut words[..count] {
            *word = reader.u16();
        }
        let content = match kind {
            0 if count == 0 => Content::Listen,
            0 => {
                let expected = HEADER_BYTES + MAC;
                return Err(DatagramError::Length { found, expected });
            }
            // The length was checked above, so the words fit.
            1 => Content::Frame(Words::new(&words[..count]).unwrap_or_default()),
            found => return Err(DatagramError::Kind { found }),
        };
        Ok(Self { machine, answers, content })
    }

    /// Encodes the command in `bytes`, with its authentication code, and returns the length of the datagram in bytes.
    pub fn encode(&self, key: &Key, bytes: &mut [u8; COMMAND_BYTES]) -> usize {
        let (kind, words): (u16, &[u16]) = match &self.content {
            Content::Listen => (0, &[]),
            Content::Frame(words) => (1, words.as_slice()),
        };
        let count = u16::try_from(words.len()).unwrap_or(0);
        let mut writer = Writer::new(bytes);
        writer.put(&MAGIC);
        writer.put(&[VERSION, 0]);
        writer.put(&self.machine.to_le_bytes());
        for number in self.answers {
            writer.put(&number.to_le_bytes());
        }
        writer.put(&kind.to_le_bytes());
        writer.put(&count.to_le_bytes());
        for word in words {
            writer.put(&word.to_le_bytes());
        }
        writer.seal(key)
    }
}
