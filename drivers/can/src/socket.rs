use std::{
    io::{Error, ErrorKind},
    time::Instant,
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
};
use socketcan::{
    CanAnyFrame, CanDataFrame, CanFdFrame, CanFdSocket, CanFilter, EmbeddedFrame, ExtendedId,
    Frame as _, Id, Socket, SocketOptions, StandardId,
    id::{CAN_EFF_FLAG, CAN_EFF_MASK, CAN_RTR_FLAG},
};
use volcomp_port::{DeviceError, Fault};

use crate::{
    arrival::{Arrivals, both_clocks},
    frame::{CanPort, Frame, Received},
};

/// Error class of an error frame that reports bus-off.
const BUS_OFF: u32 = 0x40;

/// A CAN interface of Linux.
#[derive(Debug)]
pub struct CanSocket {
    device: String,
    socket: CanFdSocket,
    arrivals: Arrivals,
}

impl CanSocket {
    /// Name of the device in messages, such as `can://can0` for the interface `can0`.
    pub fn device_of(interface: &str) -> String {
        format!("can://{interface}")
    }

    /// Opens an interface such as `can0` or `vcan0`.
    ///
    /// # Errors
    /// An interface that does not exist, or a kernel without CAN.
    pub fn open(interface: &str) -> Result<Self, DeviceError> {
        let device = Self::device_of(interface);
        let failed = |e: Error| {
            let remedy = "check its name (ip link), and bring it up: ip link set can0 up type can bitrate 500000";
            DeviceError::open(&*device, format!("the interface cannot be opened: {e}"), remedy)
        };
        let (now, wall) = both_clocks();
        let arrivals = Arrivals::empty_at(now, wall);
        let socket = CanFdSocket::open(interface).map_err(failed)?;
        socket.set_nonblocking(true).map_err(failed)?;
        socket.set_error_filter_accept_all().map_err(failed)?;
        // If the kernel provides no timestamps, every frame gets its maximum age.
        let _ = socket.set_recv_timestamp(true);
        Ok(Self { device, socket, arrivals })
    }

    fn wait(&self, what: PollFlags, deadline: Instant) -> Result<bool, Fault> {
        let left = deadline.saturating_duration_since(Instant::now());
        let left = Timespec::try_from(left).map_err(|_| Fault::TimedOut)?;
        match poll(&mut [PollFd::new(&self.socket, what)], Some(&left)) {
            Ok(ready) => Ok(ready > 0),
            Err(Errno::INTR) => Ok(true),
            Err(_) => Err(Fault::Disconnected),
        }
    }
}

impl CanPort for CanSocket {
    fn device(&self) -> &str {
        &self.device
    }

    /// Sets a filter of the kernel. Without it frames of other devices would fill the socket's queue, and delay or lose
    /// the frames that are used.
    fn accept_only(&mut self, ids: &[(u32, bool)]) {
        let filter = |&(id, extended): &(u32, bool)| {
            let kind = if extended { CAN_EFF_FLAG } else { 0 };
            CanFilter::new(id | kind, CAN_EFF_MASK | CAN_EFF_FLAG | CAN_RTR_FLAG)
        };
        let filters: Vec<CanFilter> = ids.iter().map(filter).collect();
        // If the kernel refuses the filter, all frames are received and most are ignored.
        let _ = self.socket.set_filters(&filters);
    }

    fn receive(&mut self, deadline: Instant) -> Result<Option<Received>, Fault> {
        loop {
            let (now, wall) = both_clocks();
            match self.socket.read_frame_with_timestamps() {
                Ok((frame, stamps)) => {
                    let arrived = self.arrivals.of(stamps.socket, now, wall);
                    if let Some(received) = received(&frame, arrived) {
                        return Ok(Some(received));
                    }
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => {
                    self.arrivals = Arrivals::empty_at(now, wall);
                    if Instant::now() >= deadline || !self.wait(PollFlags::IN, deadline)? {
                        return Ok(None);
                    }
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => return Err(Fault::Disconnected),
            }
        }
    }

    fn send(&mut self, frame: &Frame, deadline: Instant) -> Result<(), Fault> {
        let raw = to_socket(frame).ok_or(Fault::Unsupported("a frame of this length"))?;
        loop {
            match self.socket.write_frame(&raw) {
                Ok(()) => return Ok(()),
                // The send queue is full, because the bus accepts frames slowly or not at all.
                Err(e) if is_full(&e) => {
                    if Instant::now() >= deadline || !self.wait(PollFlags::OUT, deadline)? {
                        return Err(Fault::TimedOut);
                    }
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(_) => return Err(Fault::Disconnected),
            }
        }
    }
}

fn is_full(error: &Error) -> bool {
    error.kind() == ErrorKind::WouldBlock
        || error.raw_os_error() == Some(Errno::NOBUFS.raw_os_error())
}

/// Decodes a received frame; `None` for remote frames, which are not supported.
fn received(frame: &CanAnyFrame, arrived: Instant) -> Option<Received> {
    let (fd, data) = match frame {
        CanAnyFrame::Normal(frame) => (false, frame.data()),
        CanAnyFrame::Fd(frame) => (true, frame.data()),
        CanAnyFrame::Error(frame) => {
            let off = frame.id_word() & BUS_OFF != 0;
            return Some(if off { Received::BusOff } else { Received::Error });
        }
        CanAnyFrame::Remote(_) => return None,
    };
    let frame = Frame::new(frame.raw_id(), frame.is_extended(), fd, data)?;
    Some(Received::Frame(frame, arrived))
}

fn to_socket(frame: &Frame) -> Option<CanAnyFrame> {
    let id = if frame.extended {
        Id::Extended(ExtendedId::new(frame.id)?)
    } else {
        Id::Standard(StandardId::new(u16::try_from(frame.id).ok()?)?)
    };
    if frame.fd {
        return CanFdFrame::new(id, frame.data()).map(CanAnyFrame::Fd);
    }
    CanDataFrame::new(id, frame.data()).map(CanAnyFrame::Normal)
}
