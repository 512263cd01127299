//! Switches of a simulated machine.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::AxisLog;

/// Switches with which a test disturbs a running machine, and the record of its axes. The machine reads them on every call and takes them as valid
/// since the previous call.
#[derive(Debug, Default)]
pub struct Controls {
    /// The axes are not referenced: the machine stops.
    pub unreferenced: AtomicBool,
    /// An alarm is on: the machine stops.
    pub alarm: AtomicBool,
    /// The emergency stop is pressed: the machine stops.
    pub emergency_stop: AtomicBool,
    /// Feed hold: the machine stops, without an interlock.
    pub feed_hold: AtomicBool,
    /// The reported positions freeze.
    pub frozen: AtomicBool,
    /// The connection is lost, on every path to the machine.
    pub disconnected: AtomicBool,
    /// On the next call the applied correction is cleared, as after a reboot without retained data; then it is false again. The control's program
    /// restarts at zero.
    pub clear_applied: AtomicBool,
    /// On the next call the control restarts with the applied correction still in the words of its axes; then it is false again. No effect if the
    /// control runs no program.
    pub restart: AtomicBool,
    /// Number of corrections applied or frames posted.
    pub heartbeat: AtomicU64,
    /// Corrections that the axes got.
    pub axes: AxisLog,
}

impl Controls {
    /// Emergency stop, alarm or not referenced: corrections are held.
    pub(super) fn holds(&self) -> bool {
        [&self.unreferenced, &self.alarm, &self.emergency_stop]
            .iter()
            .any(|switch| switch.load(Ordering::Relaxed))
    }

    /// Whether the machine stops.
    pub(super) fn stands(&self) -> bool {
        self.holds() || self.feed_hold.load(Ordering::Relaxed)
    }
}
