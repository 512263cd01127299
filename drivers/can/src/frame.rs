use std::time::Instant;

use volcomp_port::Fault;

/// One classic or FD frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Identifier of the frame: 11 bits, or 29 bits if `extended` is set.
    pub id: u32,
    pub extended: bool,
    pub fd: bool,
    length: u8,
    bytes: [u8; 64],
}

impl Frame {
    /// Creates a frame; `None` for an invalid length or identifier. Valid lengths are 0 to 8, and for FD frames also
    /// 12, 16, 20, 24, 32, 48, 64.
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
        Some(Self { id, extended, fd, length, bytes })
    }

    pub fn data(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.length)).unwrap_or_default()
    }

    pub fn data_mut(&mut self) -> &mut [u8] {
        self.bytes.get_mut(..usize::from(self.length)).unwrap_or_default()
    }
}

/// A received frame or error report.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A frame with its arrival time. The arrival time is never later than the true arrival, so the time that the frame
    /// waited unread counts towards its age.
    Frame(Frame, Instant),
    /// The bus controller reports errors.
    Error,
    /// The controller left the bus after too many errors; it neither sends nor receives until restarted.
    BusOff,
}

/// Maximum number of frames processed per read, so that a flooded bus cannot delay a cycle.
pub(crate) const MAX_FRAMES_PER_READ: usize = 256;

/// A CAN bus. Its methods are for real-time cycles: they do not allocate, and each ends at its deadline.
pub trait CanPort: Send {
    fn device(&self) -> &str;

    /// Asks the port to deliver only frames with these identifiers; `true` means that the identifier has 29 bits. The
    /// port may still deliver other frames, for example frames that were already queued.
    fn accept_only(&mut self, _ids: &[(u32, bool)]) {}

    /// Receives the next frame or error report; `None` if none arrived before the deadline. A frame that is already
    /// waiting is returned even after the deadline.
    ///
    /// # Errors
    /// [`Fault::Disconnected`] if the interface is down or was removed.
    fn receive(&mut self, deadline: Instant) -> Result<Option<Received>, Fault>;

    /// Sends a frame.
    ///
    /// # Errors
    /// [`Fault::Disconnected`], or [`Fault::TimedOut`] if the bus accepts no frame.
    fn send(&mut self, frame: &Frame, deadline: Instant) -> Result<(), Fault>;
}

/// A bus that is not opened, for checking a configuration. It receives no frames.
pub(crate) struct UnopenedBus(pub(crate) String);

impl CanPort for UnopenedBus {
    fn device(&self) -> &str {
        &self.0
    }

    fn receive(&mut self, _deadline: Instant) -> Result<Option<Received>, Fault> {
        Err(Fault::NotConnected)
    }

    fn send(&mut self, _frame: &Frame, _deadline: Instant) -> Result<(), Fault> {
        Err(Fault::NotConnected)
    }
}
