//! Words as bytes.

/// In which order the two bytes of a word stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ByteOrder {
    /// The low byte first, as in the memory of a FANUC PMC.
    LowFirst,
    /// The high byte first, as in a data block of a Siemens control.
    HighFirst,
}

impl ByteOrder {
    pub(crate) fn word(self, bytes: [u8; 2]) -> u16 {
        match self {
            Self::LowFirst => u16::from_le_bytes(bytes),
            Self::HighFirst => u16::from_be_bytes(bytes),
        }
    }
}

/// The bytes of words, two for each.
pub fn to_bytes(words: &[u16], order: ByteOrder) -> Vec<u8> {
    let bytes = words.iter().flat_map(|word| match order {
        ByteOrder::LowFirst => word.to_le_bytes(),
        ByteOrder::HighFirst => word.to_be_bytes(),
    });
    bytes.collect()
}
