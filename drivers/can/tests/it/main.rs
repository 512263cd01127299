//! Tests of signals, compared with cantools, and of the bridge and the CANopen consumer on a bus in memory.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod barrier;
mod bridge;
mod canopen;
mod contracts;
mod peer;
mod reference;
mod signals;

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_can::{BridgeConfig, CanPort, Frame, Received, SHIPPED_DBC, SignalTable};
use volcomp_port::Fault;
use volcomp_vocabulary::AxisName;

/// Aborts the test if a cycle allocates or frees memory.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// A bus in memory: received and sent frames, and whether the interface is down.
#[derive(Clone, Default)]
pub(crate) struct Bus(Arc<Mutex<BusState>>);

#[derive(Default)]
pub(crate) struct BusState {
    pub(crate) incoming: VecDeque<Received>,
    pub(crate) sent: Vec<Frame>,
    pub(crate) down: bool,
    /// Identifiers that were asked for; `true`: 29 bits.
    pub(crate) asked: Vec<(u32, bool)>,
}

impl Bus {
    pub(crate) fn state(&self) -> std::sync::MutexGuard<'_, BusState> {
        self.0.lock().unwrap()
    }

    pub(crate) fn deliver(&self, frame: Frame) {
        self.state().incoming.push_back(Received::Frame(frame, Instant::now()));
    }

    pub(crate) fn sent(&self) -> Vec<Frame> {
        std::mem::take(&mut self.state().sent)
    }
}

impl CanPort for Bus {
    fn device(&self) -> &'static str {
        "can://memory"
    }

    fn accept_only(&mut self, ids: &[(u32, bool)]) {
        self.state().asked = ids.to_vec();
    }

    fn receive(&mut self, deadline: Instant) -> Result<Option<Received>, Fault> {
        loop {
            let mut state = self.state();
            if state.down {
                return Err(Fault::Disconnected);
            }
            if let Some(next) = state.incoming.pop_front() {
                return Ok(Some(next));
            }
            drop(state);
            if Instant::now() >= deadline {
                return Ok(None);
            }
            std::thread::sleep(Duration::from_micros(100));
        }
    }

    fn send(&mut self, frame: &Frame, _: Instant) -> Result<(), Fault> {
        let mut state = self.state();
        if state.down {
            return Err(Fault::Disconnected);
        }
        state.sent.push(*frame);
        Ok(())
    }
}

pub(crate) fn shipped() -> SignalTable {
    SignalTable::parse(SHIPPED_DBC).unwrap()
}

pub(crate) fn config(dbc: &str, axes: &[AxisName]) -> BridgeConfig {
    BridgeConfig {
        table: SignalTable::parse(dbc).unwrap(),
        channel: "bridge".to_owned(),
        axes: axes.to_vec(),
        reads: Vec::new(),
        includes_correction: false,
    }
}

pub(crate) fn soon() -> Instant {
    Instant::now() + Duration::from_secs(3)
}

/// Frame of a message with these values, with counter and checksum.
pub(crate) fn frame_of(
    table: &SignalTable,
    name: &str,
    values: &[(&str, f64)],
    counter: u64,
) -> Frame {
    let message = table.messages.iter().find(|m| m.name == name).unwrap();
    let mut frame = message.frame().unwrap();
    for (signal, value) in values {
        let signal = message.signals.iter().find(|s| s.name == *signal).unwrap();
        assert!(signal.put(frame.data_mut(), *value), "{name}");
    }
    message.seal(frame.data_mut(), counter);
    frame
}
