//! Reads and writes the words of a correction map in the PMC, over a separate session.

use std::time::Duration;

use crate::{Client, FocasError, PmcAddress};

const MAX_READ_BYTES: usize = 128;

/// PMC addresses of the correction map in a control that looks up its corrections in the map. Each word has two bytes,
/// low byte first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapPlaces {
    pub mailbox: PmcAddress,
    pub report: PmcAddress,
    /// First byte of the first buffer. The second buffer follows directly.
    pub buffers: PmcAddress,
    pub capacity: usize,
}

impl MapPlaces {
    /// Address after the last byte of buffer 0 or 1.
    fn end(&self, buffer: u16) -> usize {
        usize::from(self.buffers.at) + 2 * self.capacity * (usize::from(buffer) + 1)
    }

    /// Whether both buffers end within the 16-bit addresses of a request.
    pub fn fits(&self) -> bool {
        self.end(1) <= usize::from(u16::MAX) + 1
    }
}

/// An open session that transfers a map to the PMC. Every exchange has a timeout. Drop the session after a failed
/// exchange, because its state is unknown.
pub struct MapWords {
    client: Client,
    places: MapPlaces,
}

impl MapWords {
    /// Connects to a control. `at_most` is the timeout of this call and of every exchange.
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

    /// Reads the first `words` words of the report.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn report(&mut self, words: usize) -> Result<Vec<u16>, FocasError> {
        self.read(self.places.report, 0, words)
    }

    /// Writes the words of the mailbox in one command.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn write(&mut self, words: &[u16]) -> Result<(), FocasError> {
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let to = self.places.mailbox;
        self.client.write_pmc(to.area, to.at, &bytes)
    }

    /// Reads the first `count` words of buffer 0 or 1. Reads at most `capacity` words.
    ///
    /// # Errors
    /// See [`FocasError`].
    pub fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, FocasError> {
        let skip = 2 * self.places.capacity * usize::from(buffer.min(1));
        let count = count.min(self.places.capacity);
        self.read(self.places.buffers, skip, count)
    }

    /// Reads `words` words. The first word starts `skip` bytes after `from`.
    fn read(
        &mut self,
        from: PmcAddress,
        skip: usize,
        words: usize,
    ) -> Result<Vec<u16>, FocasError> {
        let mut found = Vec::with_capacity(words);
        let (mut at, end) = (usize::from(from.at) + skip, usize::from(from.at) + skip + 2 * words);
        while at < end {
            let count = (end - at).min(MAX_READ_BYTES);
            // An address too large for a request is replaced by the largest address, which the control rejects.
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
