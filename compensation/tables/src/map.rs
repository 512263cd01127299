//! The map of the corrections over the work space, as words.

use volcomp_guard::protocol::checksum;

use crate::{
    ByteOrder, HEADER_WORDS, Header, NoMap, OUTPUTS, Position, bytes::to_bytes,
    interpolation::look_up,
};

/// A map: its head and its values. It holds together: every place that a look-up reads is there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Map {
    header: Header,
    words: Vec<u16>,
}

impl Map {
    /// A map of these values in parts of the output's steps: all outputs of a node, then the next node along the last axis.
    ///
    /// # Errors
    /// A head that no control can use, or another number of values than it says.
    pub fn new(header: Header, values: &[i16]) -> Result<Self, NoMap> {
        header.check()?;
        if values.len() != header.values() {
            return Err(NoMap::Count {
                found: values.len() + HEADER_WORDS,
                expected: header.words(),
            });
        }
        let mut words = header.encode().to_vec();
        words.extend(values.iter().map(|value| value.cast_unsigned()));
        Ok(Self { header, words })
    }

    /// A map from its words.
    ///
    /// # Errors
    /// Words that are no map.
    pub fn from_words(words: &[u16]) -> Result<Self, NoMap> {
        let header = Header::decode(words)?;
        if words.len() != header.words() {
            return Err(NoMap::Count {
                found: words.len(),
                expected: header.words(),
            });
        }
        let words = words.to_vec();
        Ok(Self { header, words })
    }

    /// The head.
    #[must_use]
    pub fn header(&self) -> &Header {
        &self.header
    }

    /// The words of head and values.
    #[must_use]
    pub fn words(&self) -> &[u16] {
        &self.words
    }

    /// The two words of the checksum, started from the number of the machine and the axes that are corrected.
    #[must_use]
    pub fn checksum(&self, machine: u16) -> [u16; 2] {
        let check = checksum(machine, self.header.outputs, &self.words);
        [check.sum, check.of_sums]
    }

    /// The correction of each output at a position, in parts of its step.
    #[must_use]
    pub fn parts(&self, position: &Position) -> [i32; OUTPUTS] {
        look_up(&self.header, &self.words, position)
    }

    /// The correction of each output at a position, mm.
    #[must_use]
    pub fn correction_mm(&self, position: &Position) -> [f64; OUTPUTS] {
        let parts = self.parts(position);
        core::array::from_fn(|output| {
            let step_mm = f64::from(self.header.output_step_nm[output]) * 1e-6;
            f64::from(parts[output]) * step_mm / f64::from(self.header.scale)
        })
    }

    /// The image: head, values, checksum.
    #[must_use]
    pub fn image(&self, machine: u16, order: ByteOrder) -> Vec<u8> {
        let mut words = self.words.clone();
        words.extend(self.checksum(machine));
        to_bytes(&words, order)
    }

    /// Reads an image in either order of bytes.
    ///
    /// # Errors
    /// Bytes that are no map, are damaged, or are for another machine.
    pub fn from_image(bytes: &[u8], machine: u16) -> Result<Self, NoMap> {
        if !bytes.len().is_multiple_of(2) {
            return Err(NoMap::OddBytes { found: bytes.len() });
        }
        let order = match bytes.first() {
            Some(b'V') => ByteOrder::HighFirst,
            _ => ByteOrder::LowFirst,
        };
        let words = bytes
            .chunks_exact(2)
            .map(|pair| order.word([pair[0], pair[1]]));
        let words: Vec<u16> = words.collect();
        let (words, check) = words
            .split_last_chunk::<2>()
            .ok_or(NoMap::Short { found: words.len() })?;
        let map = Self::from_words(words)?;
        if map.checksum(machine) != *check {
            return Err(NoMap::Checksum);
        }
        Ok(map)
    }
}
