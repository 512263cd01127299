//! Interface of a program that runs in a simulated control and determines its corrections.

use volcomp_vocabulary::PerChannel;

use crate::Words;

/// A program of a simulated control that determines the corrections of its axes, such as a barrier in the ladder of a
/// real control. Values are whole counts of each axis, in channel order.
pub trait ControlProgram: Send {
    /// Runs one scan and returns the report to publish. `mailboxes` has the words of each mailbox, copied before this
    /// call. `holds` is true during emergency stop or alarm, or while an axis is not referenced.
    fn scan(&mut self, mailboxes: &[&[u16]], holds: bool) -> Words;

    /// Sets the digital lines for the next scans: `value` (counts) for the axis with this index, and the level of the
    /// latch line, which toggles after the other lines have settled. By default the lines have no effect.
    fn lines(&mut self, latch: bool, axis: usize, value: i16) {
        let _ = (latch, axis, value);
    }

    /// Correction applied to each axis, counts.
    fn applied(&self) -> PerChannel<i16>;

    /// Restarts the program at power-up or reset of the control. `applied` is the correction that the axis words
    /// contain, counts.
    fn restart(&mut self, applied: &PerChannel<i16>);
}
