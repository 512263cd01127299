use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::AxisLog;

/// Switches with which a test disturbs a running machine, and the record of its corrections. The machine reads the switches on every call,
/// and treats them as set since the previous call.
#[derive(Debug, Default)]
pub struct Controls {
    /// The axes are not referenced: the machine stops.
    pub unreferenced: AtomicBool,
    /// An alarm is on: the machine stops.
    pub alarm: AtomicBool,
    /// The emergency stop is pressed: the machine stops.
    pub emergency_stop: AtomicBool,
    /// Feed hold: the machine stops, but corrections are not held.
    pub feed_hold: AtomicBool,
    /// The reported positions no longer change, although the axes move.
    pub frozen: AtomicBool,
    /// All connections to the machine are lost.
    pub disconnected: AtomicBool,
    /// At the next call the machine clears the applied correction, as in a reboot without retained data, restarts the control's program at
    /// zero, and resets this switch.
    pub clear_applied: AtomicBool,
    /// At the next call the control restarts with the applied correction still in the words of its axes, and resets this switch. No effect
    /// if the control runs no program.
    pub restart: AtomicBool,
    /// Number of corrections or frames that were written.
    pub heartbeat: AtomicU64,
    /// Corrections applied to the axes.
    pub axes: AxisLog,
}

impl Controls {
    /// Whether corrections are held: by emergency stop or alarm, or because the axes are not referenced.
    pub(super) fn holds(&self) -> bool {
        [&self.unreferenced, &self.alarm, &self.emergency_stop]
            .iter()
            .any(|switch| switch.load(Ordering::Relaxed))
    }

    /// Whether the machine stops its program.
    pub(super) fn stands(&self) -> bool {
        self.holds() || self.feed_hold.load(Ordering::Relaxed)
    }
}
