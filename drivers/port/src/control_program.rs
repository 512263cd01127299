//! What a control's own program does with corrections, for simulated controls.

use volcomp_vocabulary::PerChannel;

use crate::Words;

/// The program of a control that decides what its axes get: a barrier. Simulated controls run one, so that what they do
/// is what a control does that has the barrier in its ladder. Values are whole counts of each axis, in channel order.
pub trait ControlProgram: Send {
    /// One scan. `mailboxes` are the words of each way that leads here, copied before this call; `holds`: emergency
    /// stop, alarm or not referenced. Gives the report to be published.
    fn scan(&mut self, mailboxes: &[&[u16]], holds: bool) -> Words;

    /// From the next scan on, plain lines that lead here carry this word (counts) for the axis at this place, and this level
    /// of the line that says when they have settled. A program that takes nothing from lines leaves them.
    fn lines(&mut self, latch: bool, axis: usize, value: i16) {
        let _ = (latch, axis, value);
    }

    /// The correction that the axes get, counts.
    fn applied(&self) -> PerChannel<i16>;

    /// Power-up or a reset of the control: the words of the axes hold these counts.
    fn restart(&mut self, applied: &PerChannel<i16>);
}
