//! Decoding of CANopen frames, and encoding of the frames that a consumer sends.

use crate::frame::Frame;

/// State of a node, as reported in its heartbeat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum NodeState {
    /// The node has just started.
    BootUp,
    /// The node was stopped, and sends only its heartbeat.
    Stopped,
    /// The node sends process data.
    Operational,
    /// The node waits for its start.
    PreOperational,
    /// Another state; the number is the code in the heartbeat.
    Other(u8),
}

impl NodeState {
    fn from_code(code: u8) -> Self {
        match code & 0x7f {
            0 => Self::BootUp,
            4 => Self::Stopped,
            5 => Self::Operational,
            0x7f => Self::PreOperational,
            other => Self::Other(other),
        }
    }
}

/// A decoded CANopen frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Telegram {
    /// Heartbeat of a node.
    Heartbeat {
        /// Number of the node, 1 to 127.
        node: u8,
        /// State of the node at the time of the heartbeat.
        state: NodeState,
    },
    /// Emergency message of a node.
    Emergency {
        /// Number of the node, 1 to 127.
        node: u8,
        /// Error code by CiA 301; 0 when all errors are cleared.
        code: u16,
    },
    /// Process data sent by a node (TPDO).
    Pdo {
        /// Number of the node, 1 to 127.
        node: u8,
        /// Number of the process data object, 1 to 4.
        number: u8,
    },
    /// Response to a read or write request for an object.
    Sdo {
        /// Number of the node, 1 to 127.
        node: u8,
        /// Result of the transfer.
        answer: SdoAnswer,
    },
}

/// Response to an expedited SDO transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum SdoAnswer {
    /// The object was read: up to four bytes, little-endian.
    Read {
        /// Index and subindex of the object.
        object: (u16, u8),
        /// Bytes of the object as a little-endian number; unused bytes are 0.
        value: u32,
        /// Number of bytes of the object in `value`, 1 to 4.
        bytes: u8,
    },
    Written {
        /// Index and subindex of the object.
        object: (u16, u8),
    },
    /// The node rejects the transfer.
    Aborted {
        /// Index and subindex of the object.
        object: (u16, u8),
        /// Abort code by CiA 301.
        code: u32,
    },
    /// A segmented transfer, which this consumer does not support.
    Segmented {
        /// Index and subindex of the object.
        object: (u16, u8),
    },
}

/// Identifiers of the telegrams that are received cyclically, without the number of the node: emergency, process data 1
/// to 4, heartbeat.
pub(super) const RECEIVED_FUNCTIONS: [u32; 6] = [0x080, 0x180, 0x280, 0x380, 0x480, 0x700];

/// Decodes a frame; `None` if the frame is malformed or not one of these telegrams.
pub fn telegram(frame: &Frame) -> Option<Telegram> {
    if frame.extended || frame.fd {
        return None;
    }
    let node = u8::try_from(frame.id & 0x7f).ok().filter(|node| *node > 0)?;
    let data = frame.data();
    let number = |function: u32| u8::try_from((function - 0x180) / 0x100 + 1).ok();
    match frame.id & 0x780 {
        0x700 => Some(Telegram::Heartbeat { node, state: NodeState::from_code(*data.first()?) }),
        0x080 => Some(Telegram::Emergency { node, code: u16::from_le_bytes(*data.first_chunk()?) }),
        function @ (0x180 | 0x280 | 0x380 | 0x480) => {
            Some(Telegram::Pdo { node, number: number(function)? })
        }
        0x580 => Some(Telegram::Sdo { node, answer: sdo_answer(*data.first_chunk()?)? }),
        _ => None,
    }
}

fn sdo_answer(data: [u8; 8]) -> Option<SdoAnswer> {
    let [command, low, high, sub, a, b, c, d] = data;
    let object = (u16::from_le_bytes([low, high]), sub);
    let value = u32::from_le_bytes([a, b, c, d]);
    Some(match command >> 5 {
        2 if command & 0b10 != 0 => {
            // If no size is indicated, all four bytes are valid.
            let unused = if command & 1 == 1 { command >> 2 & 3 } else { 0 };
            let bytes = 4 - unused;
            SdoAnswer::Read { object, value: value & (u32::MAX >> (8 * unused)), bytes }
        }
        2 => SdoAnswer::Segmented { object },
        3 => SdoAnswer::Written { object },
        4 => SdoAnswer::Aborted { object, code: value },
        _ => return None,
    })
}

/// Network management (NMT) commands of CiA 301, which change the state of nodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum NmtCommand {
    /// The node starts to send process data.
    Start = 1,
    /// The node stops sending and reacts to network management only.
    Stop = 2,
    /// The node waits to be started.
    PreOperational = 128,
    /// The node restarts, including its application.
    Reset = 129,
}

/// Creates the frame that sends a command to a node (0: to all nodes).
pub fn nmt(command: NmtCommand, node: u8) -> Option<Frame> {
    Frame::new(0, false, false, &[command as u8, node])
}

/// Creates the frame that requests an object; `None` for an invalid node number.
pub fn sdo_read(node: u8, (index, sub): (u16, u8)) -> Option<Frame> {
    let [low, high] = index.to_le_bytes();
    let data = [0x40, low, high, sub, 0, 0, 0, 0];
    Frame::new(0x600 + u32::from(node), false, false, &data)
}

/// Creates the frame that writes an object of 1 to 4 bytes; `None` for another length or an invalid node number.
pub fn sdo_write(node: u8, (index, sub): (u16, u8), value: &[u8]) -> Option<Frame> {
    let unused = 4_usize.checked_sub(value.len()).filter(|unused| *unused < 4)?;
    let [low, high] = index.to_le_bytes();
    let mut data = [0x23 | u8::try_from(unused << 2).ok()?, low, high, sub, 0, 0, 0, 0];
    data[4..4 + value.len()].copy_from_slice(value);
    Frame::new(0x600 + u32::from(node), false, false, &data)
}
