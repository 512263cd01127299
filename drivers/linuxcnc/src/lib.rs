#![doc = include_str!("../README.md")]

mod adrift;
mod age;
mod command;
mod controller;
mod ini;
mod look;
mod state;

pub use command::{COMMAND_BYTES, Command, Content};
pub use controller::{Health, LinuxCncConfig, LinuxCncController};
pub use ini::{Expected, Ini, Least, Problem};
pub use look::look;
pub use state::{AxisState, Broken, Flags, STATE_BYTES, State};

/// The UDP port of a bridge whose configuration names none.
pub const PORT: u16 = 47_001;

/// The version of the protocol.
pub const VERSION: u8 = 1;

/// The checksum of datagrams: CRC-32 as Ethernet and zip have it.
const CRC: crc::Crc<u32, crc::Table<16>> =
    crc::Crc::<u32, crc::Table<16>>::new(&crc::CRC_32_ISO_HDLC);

/// The bytes of a datagram without its checksum, where that fits.
fn whole(bytes: &[u8]) -> Result<&[u8], Broken> {
    let (body, check) = bytes.split_last_chunk::<4>().ok_or(Broken::Length {
        found: bytes.len(),
        expected: 4,
    })?;
    if CRC.checksum(body) == u32::from_le_bytes(*check) {
        Ok(body)
    } else {
        Err(Broken::Checksum)
    }
}

/// Appends bytes to a datagram of fixed room.
struct Writer<'a> {
    bytes: &'a mut [u8],
    length: usize,
}

impl<'a> Writer<'a> {
    fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, length: 0 }
    }

    /// Appends these bytes; the room of every datagram is that of its largest content.
    fn put(&mut self, more: &[u8]) {
        let end = self.length + more.len();
        if let Some(room) = self.bytes.get_mut(self.length..end) {
            room.copy_from_slice(more);
            self.length = end;
        }
    }

    /// Appends the checksum. How many bytes there are.
    fn seal(mut self) -> usize {
        let check = CRC.checksum(&self.bytes[..self.length]);
        self.put(&check.to_le_bytes());
        self.length
    }
}

/// Takes bytes from a datagram whose length was checked.
struct Reader<'a>(&'a [u8]);

impl Reader<'_> {
    /// The next bytes; zeros where there are none left.
    fn take<const N: usize>(&mut self) -> [u8; N] {
        let Some((head, rest)) = self.0.split_first_chunk::<N>() else {
            return [0; N];
        };
        self.0 = rest;
        *head
    }

    fn u8(&mut self) -> u8 {
        u8::from_le_bytes(self.take())
    }

    fn u16(&mut self) -> u16 {
        u16::from_le_bytes(self.take())
    }

    fn u32(&mut self) -> u32 {
        u32::from_le_bytes(self.take())
    }
}
