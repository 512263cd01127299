//! Signals against cantools, the bridge and the CANopen consumer on a bus in memory.

#![allow(clippy::unwrap_used, reason = "a test fails by panicking")]

mod barrier;
mod bridge;
mod canopen;
mod contracts;
mod fuzz_corpus;
mod meant;
mod peer;
mod reference;
mod serialised;
mod signals;

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_can::{CanPort, Frame, Received, SHIPPED_DBC, SignalTable};
use volcomp_port::Fault;

/// Allocating or freeing where a cycle calls ends the test.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// A bus in memory: what will be received, what was sent, and whether it is there.
#[derive(Clone, Default)]
pub(crate) struct Bus(Arc<Mutex<Inside>>);

#[derive(Default)]
pub(crate) struct Inside {
    pub(crate) coming: VecDeque<Received>,
    pub(crate) sent: Vec<Frame>,
    pub(crate) down: bool,
}

impl Bus {
    pub(crate) fn inside(&self) -> std::sync::MutexGuard<'_, Inside> {
        self.0.lock().unwrap()
    }

    pub(crate) fn comes(&self, frame: Frame) {
        self.inside()
            .coming
            .push_back(Received::Frame(frame, Instant::now()));
    }

    pub(crate) fn sent(&self) -> Vec<Frame> {
        std::mem::take(&mut self.inside().sent)
    }
}

impl CanPort for Bus {
    fn device(&self) -> &'static str {
        "can://memory"
    }

    fn receive(&mut self, deadline: Instant) -> Result<Option<Received>, Fault> {
        loop {
            let mut inside = self.inside();
            if inside.down {
                return Err(Fault::Disconnected);
            }
            if let Some(next) = inside.coming.pop_front() {
                return Ok(Some(next));
            }
            drop(inside);
            if Instant::now() >= deadline {
                return Ok(None);
            }
            std::thread::sleep(Duration::from_micros(100));
        }
    }

    fn send(&mut self, frame: &Frame, _: Instant) -> Result<(), Fault> {
        let mut inside = self.inside();
        if inside.down {
            return Err(Fault::Disconnected);
        }
        inside.sent.push(*frame);
        Ok(())
    }
}

pub(crate) fn shipped() -> SignalTable {
    SignalTable::parse(SHIPPED_DBC).unwrap()
}

pub(crate) fn soon() -> Instant {
    Instant::now() + Duration::from_millis(30)
}

/// A sealed frame of a message with these values.
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
