use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::AxisLog;

/// Switches with which a test disturbs a running machine, and the log of its corrections. Every call of the machine
/// reads the switches, and treats them as set since the previous call.
#[derive(Debug, Default)]
pub struct Controls {
    /// An axis is not referenced, and the machine stops.
    pub unreferenced: AtomicBool,
    /// An alarm is active, and the machine stops.
    pub alarm: AtomicBool,
    /// The emergency stop is pressed, and the machine stops.
    pub emergency_stop: AtomicBool,
    /// Feed hold: the machine stops, but its corrections may change.
    pub feed_hold: AtomicBool,
    /// The reported positions do not change, although the axes move.
    pub frozen: AtomicBool,
    pub disconnected: AtomicBool,
    /// At the next call, the machine clears the applied correction, like a reboot without retained data. It also
    /// restarts the control's program at zero, and resets this switch.
    pub clear_applied: AtomicBool,
    /// At the next call, the control restarts with the applied correction still in its axis words, and resets this
    /// switch. Has no effect if the control runs no program.
    pub restart: AtomicBool,
    /// Number of corrections or frames written since the start.
    pub heartbeat: AtomicU64,
    pub axes: AxisLog,
}

impl Controls {
    /// Whether corrections are held by an emergency stop or alarm, or because an axis is not referenced.
    pub(super) fn holds(&self) -> bool {
        [&self.unreferenced, &self.alarm, &self.emergency_stop]
            .iter()
            .any(|switch| switch.load(Ordering::Relaxed))
    }

    /// Whether the machine stops its motion: by a hold of the corrections, or by feed hold.
    pub(super) fn stands(&self) -> bool {
        self.holds() || self.feed_hold.load(Ordering::Relaxed)
    }
}
