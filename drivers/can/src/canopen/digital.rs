//! Digital lines of CiA 401 nodes.

use std::time::{Duration, Instant};

use volcomp_port::{DeviceError, DigitalIo, Fault, InputLevels, Reason};

use super::nodes::Nodes;
use crate::frame::{CanPort, Frame};

/// A CiA 401 node as a digital port. Its inputs are read from its TPDO 1, its outputs are sent in its RPDO 1.
pub struct CanopenDigital<P> {
    port: P,
    node: u8,
    nodes: Nodes,
    inputs: u32,
    outputs: u32,
    levels: Option<InputLevels>,
    /// Output levels in the last frame that the bus accepted. `None` before the first frame, or if the node has not run
    /// continuously since the last frame.
    sent: Option<u64>,
    /// True if `sent` was lost and no failed write has reported the loss yet.
    has_lost_outputs: bool,
}

impl<P: CanPort> CanopenDigital<P> {
    /// Creates a port for a node with these numbers of lines. A node whose heartbeat is older than `silent_after`
    /// counts as not running. This is the heartbeat consumer time of CiA 301; choose it by the heartbeat period of the
    /// node.
    ///
    /// # Errors
    /// A node number outside 1 to 127, or more than 64 inputs or outputs.
    pub fn new(
        mut port: P,
        node: u8,
        inputs: u32,
        outputs: u32,
        silent_after: Duration,
    ) -> Result<Self, DeviceError> {
        if !(1..=127).contains(&node) || inputs > 64 || outputs > 64 {
            let what = format!("found node {node}, {inputs} inputs, {outputs} outputs");
            let remedy = "expected nodes 1 to 127 and at most 64 lines each way";
            return Err(DeviceError::option(port.device(), what, remedy));
        }
        Ok(Self {
            nodes: Nodes::new(&mut port, [node].into_iter(), silent_after),
            port,
            node,
            inputs,
            outputs,
            levels: None,
            sent: None,
            has_lost_outputs: false,
        })
    }
}

impl<P: CanPort> DigitalIo for CanopenDigital<P> {
    fn device(&self) -> &str {
        self.port.device()
    }

    fn inputs(&self) -> u32 {
        self.inputs
    }

    fn outputs(&self) -> u32 {
        self.outputs
    }

    /// Duration of four frames at 125 kBd.
    fn shortest_cycle(&self) -> Duration {
        Duration::from_millis(4)
    }

    /// Returns the last inputs that the node sent and their arrival time. Their age is not limited as long as the node
    /// runs.
    fn read(&mut self, _deadline: Instant) -> Result<InputLevels, Fault> {
        let (own, inputs, levels) = (self.node, self.inputs, &mut self.levels);
        self.nodes.listen(&mut self.port, |node, number, frame, taken| {
            // A frame that does not contain all lines is ignored, because the missing lines would be read as off.
            if (node, number) == (own, 1) && 8 * frame.data().len() >= inputs as usize {
                let mut bytes = [0; 8];
                for (byte, received) in bytes.iter_mut().zip(frame.data()) {
                    *byte = *received;
                }
                let lines = u64::MAX.checked_shr(64 - inputs).unwrap_or(0);
                *levels = Some(InputLevels { levels: u64::from_le_bytes(bytes) & lines, taken });
            }
        })?;
        let failure = self.nodes.failure(self.node);
        if self.nodes.take_interruption(self.node) || failure.is_some() {
            // A node switches its outputs off or to its error values when it reboots, stops, fails or loses the bus.
            self.has_lost_outputs |= self.sent.take().is_some();
        }
        match (self.levels, failure) {
            (Some(found), None) => Ok(found),
            (_, Some(Reason::NoAnswer)) | (None, _) => Err(Fault::NotConnected),
            (_, Some(_)) => Err(Fault::Protocol("the node reports an error or does not run")),
        }
    }

    /// Sends the levels. If the node has lost its outputs, the next write fails, so that the caller does not continue
    /// from the lost levels.
    fn write(&mut self, levels: u64, deadline: Instant) -> Result<(), Fault> {
        let has_lost_outputs = std::mem::take(&mut self.has_lost_outputs);
        if self.nodes.failure(self.node).is_some() {
            return Err(Fault::NotConnected);
        }
        if has_lost_outputs {
            return Err(Fault::Disconnected);
        }
        let frame = outputs_frame(self.node, levels, self.outputs);
        let frame = frame.ok_or(Fault::Unsupported("this number of lines"))?;
        if Instant::now() >= deadline {
            return Err(Fault::TimedOut);
        }
        self.port.send(&frame, deadline)?;
        self.sent = Some(levels);
        Ok(())
    }

    /// Levels that the bus accepted; nodes do not acknowledge process data. `None` if the node has not run continuously
    /// since.
    fn confirmed(&self) -> Option<u64> {
        self.sent
    }

    fn reports_outputs(&self) -> bool {
        false
    }
}

/// RPDO 1 with the output levels of a node; `None` if the levels do not fit into a frame.
fn outputs_frame(node: u8, levels: u64, lines: u32) -> Option<Frame> {
    let bytes = levels.to_le_bytes();
    let count = usize::try_from(lines.div_ceil(8)).ok()?;
    Frame::new(0x200 + u32::from(node), false, false, bytes.get(..count)?)
}
