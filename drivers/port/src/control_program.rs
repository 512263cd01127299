//! Interface of the program in a simulated control that receives corrections.

use volcomp_vocabulary::PerChannel;

use crate::Words;

/// A program of a simulated control that determines the corrections of its axes: a barrier, as in the ladder of a real control. Values
/// are whole counts of each axis, in channel order.
pub trait ControlProgram: Send {
    /// Runs one scan and returns the report to publish. `mailboxes` holds the words of each mailbox, copied before this call; `holds` is true
    /// during emergency stop or alarm, or while an axis is not referenced.
    fn scan(&mut self, mailboxes: &[&[u16]], holds: bool) -> Words;

    /// Sets the digital lines that the next scans see: `value` (counts) for the axis at this index, and the level of the latch line, which
    /// toggles after the others have settled. Programs without line inputs ignore it.
    fn lines(&mut self, latch: bool, axis: usize, value: i16) {
        let _ = (latch, axis, value);
    }

    /// The correction applied to each axis, counts.
    fn applied(&self) -> PerChannel<i16>;

    /// Restarts the program at power-up or reset of the control, when the words of the axes hold the counts `applied`.
    fn restart(&mut self, applied: &PerChannel<i16>);
}
