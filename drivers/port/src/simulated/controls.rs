//! The switches of a simulated machine.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use super::AxisLog;

/// Switches by which a test disturbs a machine while it runs, and what its axes got. The machine checks them whenever
/// it is called; they count as having been so since the call before.
#[derive(Debug, Default)]
pub struct Controls {
    /// The axes are not referenced: the machine stops.
    pub unreferenced: AtomicBool,
    /// An alarm is on: the machine stops.
    pub alarm: AtomicBool,
    /// The emergency stop is pressed: the machine stops.
    pub emergency_stop: AtomicBool,
    /// The feed is held: the machine stops, nothing else.
    pub feed_hold: AtomicBool,
    /// The reported positions stay as they are.
    pub frozen: AtomicBool,
    /// The connection is gone, on every way to the machine.
    pub disconnected: AtomicBool,
    /// The next call finds the applied correction cleared, as after a reboot that keeps nothing; then it is false again.
    /// The control's program starts anew with zero.
    pub clear_applied: AtomicBool,
    /// The next call finds the control started anew, with the applied correction still in the words of its axes; then it
    /// is false again. Without a program in the control nothing is lost by that.
    pub restart: AtomicBool,
    /// How often a correction was applied, or a frame posted.
    pub heartbeat: AtomicU64,
    /// What the axes got.
    pub axes: AxisLog,
}

impl Controls {
    /// Emergency stop, alarm or not referenced: corrections stay where they are.
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
