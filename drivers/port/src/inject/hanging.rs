use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::{Duration, Instant},
};

use volcomp_vocabulary::PerChannel;

use crate::{Controller, Description, Fault, Snapshot, Words};

/// Interval at which a blocked reading checks its switch.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// A controller whose readings block while its switch is on, regardless of their deadline, like a hanging driver or
/// system call. Writes do not block.
pub struct Hanging<C> {
    inner: C,
    switch: HangSwitch,
}

/// Switch of a [`Hanging`] controller, usable from any thread.
#[derive(Clone, Debug, Default)]
pub struct HangSwitch(Arc<AtomicBool>);

impl HangSwitch {
    pub fn set(&self, hangs: bool) {
        self.0.store(hangs, Ordering::Relaxed);
    }

    fn is_on(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}

impl<C> Hanging<C> {
    /// Wraps a controller whose readings block while `switch` is on.
    pub fn new(inner: C, switch: &HangSwitch) -> Self {
        Self { inner, switch: switch.clone() }
    }
}

impl<C: Controller> Controller for Hanging<C> {
    fn description(&self) -> &Description {
        self.inner.description()
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        while self.switch.is_on() {
            thread::sleep(LOOK_EVERY);
        }
        self.inner.read(deadline)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        self.inner.post(frame, deadline)
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        self.inner.apply(corrections, deadline)
    }
}
