//! The words of a map of corrections in the PMC, over a session of their own.

use std::time::Duration;

use crate::{Client, FocasError, PmcAddress};

/// So many bytes are read by one command.
const AT_ONCE: usize = 128;

/// Where the words of a control that looks up in a map lie in the memory of its PMC, two bytes each, the low byte first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapPlaces {
    /// The first byte of the mailbox for frames.
    pub mailbox: PmcAddress,
    /// The first byte of the report.
    pub report: PmcAddress,
    /// The first byte of the first buffer; the second one lies behind it.
    pub buffers: PmcAddress,
    /// The words of one buffer.
    pub capacity: usize,
}

impl MapPlaces {
    /// The last byte of a buffer, 0 or 1.
    fn end(&self, buffer: u16) -> usize {
        usize::from(self.buffers.at) + 2 * self.capacity * (usize::from(buffer) + 1)
    }

    /// Whether both buffers lie within the addresses that a request can name.
    pub fn fits(&self) -> bool {
        self.end(1) <= usize::from(u16::MAX) + 1
    }
}

/// An open session through which a map is brought into the PMC. Every exchange ends within its time; after a failed one
/// nothing is known of the session, and it should be dropped.
pub struct MapWords {
    client: Client,
    places: MapPlaces,
}

impl MapWords {
    /// Connects to a control; every exchange takes `at_most` too.
    ///
    /// # Errors
    /// See [`Client::open`].
    pub fn open(
        host: &str,
        port: u16,
        at_most: Duration,
        places: MapPlaces,
    ) -> Result<Self, FocasError> {
        let client = Client::open(host, port, at_most)?;
        Ok(Self { client, places })
    }

    /// So many words of the report.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn report(&mut self, words: usize) -> Result<Vec<u16>, FocasError> {
        self.read(self.places.report, 0, words)
    }

    /// Writes the words of the mailbox by one command.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn write(&mut self, words: &[u16]) -> Result<(), FocasError> {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let to = self.places.mailbox;
        self.client.write_pmc(to.area, to.at, &bytes)
    }

    /// The first `count` words of a buffer, 0 or 1, `capacity` of them at the most.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, FocasError> {
        let skip = 2 * self.places.capacity * usize::from(buffer.min(1));
        let count = count.min(self.places.capacity);
        self.read(self.places.buffers, skip, count)
    }

    /// Words from so many bytes behind an address on.
    fn read(
        &mut self,
        from: PmcAddress,
        skip: usize,
        words: usize,
    ) -> Result<Vec<u16>, FocasError> {
        let mut found = Vec::with_capacity(words);
        let (mut at, end) = (
            usize::from(from.at) + skip,
            usize::from(from.at) + skip + 2 * words,
        );
        while at < end {
            let count = (end - at).min(AT_ONCE);
            // Beyond what a request can name the control refuses the largest address.
            let first = u16::try_from(at).unwrap_or(u16::MAX);
            let length = u16::try_from(count).unwrap_or(u16::MAX);
            let bytes = self.client.read_pmc(from.area, first, length)?;
            let pairs = bytes.chunks_exact(2);
            found.extend(pairs.map(|pair| u16::from_le_bytes([pair[0], pair[1]])));
            at += count;
        }
        Ok(found)
    }
}
