//! Supervises nodes by their heartbeat, and starts nodes that are pre-operational.

use std::{
    collections::BTreeMap,
    time::{Duration, Instant},
};

use volcomp_port::{Fault, Reason};

use super::telegrams::{NmtCommand, NodeState, RECEIVED_FUNCTIONS, Telegram, nmt, telegram};
use crate::frame::{CanPort, Frame, MAX_FRAMES_PER_READ, Received};

#[derive(Clone, Copy, Debug)]
struct MonitoredNode {
    state: Option<NodeState>,
    last_heartbeat: Instant,
    emergency: u16,
    started: Option<Instant>,
    /// Whether the node reported a state other than operational since [`Nodes::take_interruption`].
    was_interrupted: bool,
}

/// Monitored nodes. A node that is not operational is started. A node whose heartbeat is too old counts as not
/// answering.
#[derive(Debug)]
pub(super) struct Nodes {
    monitored: BTreeMap<u8, MonitoredNode>,
    silent_after: Duration,
}

impl Nodes {
    /// Monitors these nodes; `silent_after` is the maximum age of their heartbeat. Sets the filter of the port to the
    /// telegrams of these nodes.
    pub(super) fn new(
        port: &mut impl CanPort,
        nodes: impl Iterator<Item = u8>,
        silent_after: Duration,
    ) -> Self {
        let monitored = MonitoredNode {
            state: None,
            last_heartbeat: Instant::now(),
            emergency: 0,
            started: None,
            was_interrupted: false,
        };
        let monitored: BTreeMap<u8, _> = nodes.map(|node| (node, monitored)).collect();
        let of_node = |node: &u8| RECEIVED_FUNCTIONS.map(|base| (base + u32::from(*node), false));
        port.accept_only(&monitored.keys().flat_map(of_node).collect::<Vec<_>>());
        Self { monitored, silent_after }
    }

    /// Processes the waiting frames without blocking. Calls `process_data` with node, PDO number, frame and arrival
    /// time of each process data object. Starts a node that does not run. Errors: [`Fault::Disconnected`] if the
    /// interface is down or bus-off.
    pub(super) fn listen(
        &mut self,
        port: &mut impl CanPort,
        mut process_data: impl FnMut(u8, u8, &Frame, Instant),
    ) -> Result<(), Fault> {
        let now = Instant::now();
        for _ in 0..MAX_FRAMES_PER_READ {
            match port.receive(now)? {
                None => break,
                Some(Received::BusOff) => return Err(Fault::Disconnected),
                Some(Received::Error) => {}
                Some(Received::Frame(frame, taken)) => {
                    let Some(telegram) = telegram(&frame) else {
                        continue;
                    };
                    self.process(telegram, taken);
                    if let Telegram::Pdo { node, number } = telegram {
                        process_data(node, number, &frame, taken);
                    }
                }
            }
        }
        if let Some(frame) = self.start(now) {
            // The error may be ignored: if the bus accepts no frames, the heartbeats stop as well.
            let _ = port.send(&frame, now);
        }
        Ok(())
    }

    fn process(&mut self, telegram: Telegram, taken: Instant) {
        let (Telegram::Heartbeat { node, .. }
        | Telegram::Emergency { node, .. }
        | Telegram::Pdo { node, .. }
        | Telegram::Sdo { node, .. }) = telegram;
        let Some(monitored) = self.monitored.get_mut(&node) else {
            return;
        };
        match telegram {
            Telegram::Heartbeat { state, .. } => {
                monitored.was_interrupted |= state != NodeState::Operational;
                monitored.state = Some(state);
                monitored.last_heartbeat = taken;
            }
            Telegram::Emergency { code, .. } => monitored.emergency = code,
            _ => {}
        }
    }

    /// Creates the frame that starts a node that does not run, at most once per second and node; `None` if no node
    /// needs a start.
    fn start(&mut self, now: Instant) -> Option<Frame> {
        let needs_start = |monitored: &MonitoredNode| {
            let due = monitored
                .started
                .is_none_or(|then| now.saturating_duration_since(then) > Duration::from_secs(1));
            due && monitored.state != Some(NodeState::Operational)
        };
        let (node, monitored) =
            self.monitored.iter_mut().find(|(_, monitored)| needs_start(monitored))?;
        monitored.started = Some(now);
        nmt(NmtCommand::Start, *node)
    }

    /// Whether a node has reported a state other than operational since the last call. Even if it runs again now, it
    /// may have rebooted.
    pub(super) fn take_interruption(&mut self, node: u8) -> bool {
        let monitored = self.monitored.get_mut(&node);
        monitored.is_some_and(|monitored| std::mem::take(&mut monitored.was_interrupted))
    }

    /// Reason why the data of a node must not be used; `None` if the data are valid.
    pub(super) fn failure(&self, node: u8) -> Option<Reason> {
        let monitored = self.monitored.get(&node)?;
        if monitored.last_heartbeat.elapsed() > self.silent_after || monitored.state.is_none() {
            return Some(Reason::NoAnswer);
        }
        match monitored.state {
            Some(NodeState::Operational) if monitored.emergency == 0 => None,
            Some(NodeState::Operational) => Some(Reason::Reported),
            _ => Some(Reason::NotRead),
        }
    }
}
