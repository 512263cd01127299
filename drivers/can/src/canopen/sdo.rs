//! Reads and writes single objects of nodes (SDO).

use std::time::Instant;

use volcomp_port::Fault;

use super::telegrams::{SdoAnswer, Telegram, sdo_read, sdo_write, telegram};
use crate::frame::{CanPort, Received};

/// Reads and writes single objects of nodes, one at a time. Calls block, so this client is for configuration only.
#[derive(Debug)]
pub struct SdoClient<P> {
    port: P,
}

impl<P: CanPort> SdoClient<P> {
    pub fn new(port: P) -> Self {
        Self { port }
    }

    pub fn into_port(self) -> P {
        self.port
    }

    /// Reads an object of up to four bytes, little-endian.
    ///
    /// # Errors
    /// [`Fault::TimedOut`]; [`Fault::Refused`] with the node's abort code; [`Fault::Unsupported`] for an invalid node
    /// number, and for an object that needs more than one frame; [`Fault::Protocol`] for an unexpected response; errors
    /// of the port.
    pub fn read(&mut self, node: u8, object: (u16, u8), deadline: Instant) -> Result<u32, Fault> {
        let request = sdo_read(node, object).ok_or(Fault::Unsupported("a node number"))?;
        self.port.send(&request, deadline)?;
        match self.answer(node, object, deadline)? {
            SdoAnswer::Read { value, .. } => Ok(value),
            _ => Err(Fault::Protocol("an object that was not read")),
        }
    }

    /// Writes an object of 1 to 4 bytes.
    ///
    /// # Errors
    /// Same as [`read`](Self::read).
    pub fn write(
        &mut self,
        node: u8,
        object: (u16, u8),
        value: &[u8],
        deadline: Instant,
    ) -> Result<(), Fault> {
        let request = sdo_write(node, object, value).ok_or(Fault::Unsupported("1 to 4 bytes"))?;
        self.port.send(&request, deadline)?;
        match self.answer(node, object, deadline)? {
            SdoAnswer::Written { .. } => Ok(()),
            _ => Err(Fault::Protocol("an object that was not written")),
        }
    }

    fn answer(
        &mut self,
        node: u8,
        object_id: (u16, u8),
        deadline: Instant,
    ) -> Result<SdoAnswer, Fault> {
        while let Some(received) = self.port.receive(deadline)? {
            let Received::Frame(frame, _) = received else {
                continue;
            };
            let Some(Telegram::Sdo { node: from, answer }) = telegram(&frame) else {
                continue;
            };
            let (SdoAnswer::Read { object, .. }
            | SdoAnswer::Written { object }
            | SdoAnswer::Aborted { object, .. }
            | SdoAnswer::Segmented { object }) = answer;
            // A response to an earlier request is ignored.
            if from != node || object != object_id {
                continue;
            }
            return match answer {
                SdoAnswer::Aborted { code, .. } => {
                    Err(Fault::Refused { code: code.cast_signed(), what: "an object of the node" })
                }
                SdoAnswer::Segmented { .. } => Err(Fault::Unsupported("a transfer in segments")),
                other => Ok(other),
            };
        }
        Err(Fault::TimedOut)
    }
}
