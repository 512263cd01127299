//! Frames, and what carries them.

use std::time::Instant;

use volcomp_port::Fault;

/// One frame, classic or FD.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// The identifier of the frame: 11 bits, or 29 bits where `extended` is set.
    pub id: u32,
    /// Whether the identifier has 29 bits.
    pub extended: bool,
    /// Whether it is an FD frame.
    pub fd: bool,
    length: u8,
    bytes: [u8; 64],
}

impl Frame {
    /// A frame. `None` for a length that there is not: above 8, or of an FD frame other than 12, 16, 20, 24,
    /// 32, 48, 64.
    pub fn new(id: u32, extended: bool, fd: bool, data: &[u8]) -> Option<Self> {
        let length = u8::try_from(data.len()).ok()?;
        let known = match length {
            0..=8 => true,
            12 | 16 | 20 | 24 | 32 | 48 | 64 => fd,
            _ => false,
        };
        let most = if extended { 0x1fff_ffff } else { 0x7ff };
        if !known || id > most {
            return None;
        }
        let mut bytes = [0; 64];
        bytes.get_mut(..data.len())?.copy_from_slice(data);
        Some(Self {
            id,
            extended,
            fd,
            length,
            bytes,
        })
    }

    /// The data bytes of the frame, as many as its length says.
    pub fn data(&self) -> &[u8] {
        self.bytes
            .get(..usize::from(self.length))
            .unwrap_or_default()
    }

    /// Its data, to be changed.
    pub fn data_mut(&mut self) -> &mut [u8] {
        self.bytes
            .get_mut(..usize::from(self.length))
            .unwrap_or_default()
    }
}

/// A frame or an error report that was received from the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A frame, and when it arrived here: not when it was read, and never later than it came. A frame that waited while
    /// nobody read is as old as that.
    Frame(Frame, Instant),
    /// The controller of the bus reports errors.
    Error,
    /// The controller has left the bus.
    BusOff,
}

/// The most frames that are taken from a bus at once: a flooded bus must not hold a cycle up.
pub(crate) const AT_ONCE: usize = 256;

/// A bus. Calls of a cycle: no allocation, bounded by their deadline.
pub trait CanPort: Send {
    /// The device as the configuration names it.
    fn device(&self) -> &str;

    /// The next frame; `None` when none came before the deadline. A deadline that has passed takes what is
    /// there already.
    ///
    /// # Errors
    /// [`Fault::Disconnected`] when the interface is down or gone.
    fn receive(&mut self, deadline: Instant) -> Result<Option<Received>, Fault>;

    /// Sends a frame.
    ///
    /// # Errors
    /// [`Fault::Disconnected`], or [`Fault::TimedOut`] when the bus takes none.
    fn send(&mut self, frame: &Frame, deadline: Instant) -> Result<(), Fault>;
}
