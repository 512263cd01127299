//! Plain lines as a mailbox of a barrier.

/// What lies on plain lines in one scan. They carry no number that could tell an old or foreign word from one that is meant
/// now, so a barrier trusts them less than frames: see [`Barrier::scan_with`](super::Barrier::scan_with).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct DigitalLines {
    /// The level of the line that is turned once the others have settled.
    pub latch: bool,
    /// The place of the axis that the word is for, in channel order.
    pub axis: usize,
    /// The word: the wanted correction of that axis, counts.
    pub value: i16,
}
