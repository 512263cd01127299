//! The sender's side: what a report says, and the frame that answers it.

use super::{Counts, Frame, Report, is_ahead};

/// What a report means for a sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// The control's scans did not move on since the last report, or this one is from before it: it says nothing new.
    Old,
    /// Another sender holds the control, or this one did before its restart: nothing may be sent until the control's
    /// time-out has set it free.
    Held {
        /// The number of the other sender.
        owner: u16,
    },
    /// A whole, new report: what it says is applied is confirmed.
    Confirmed {
        /// The frame that was sent last has been taken.
        landed: bool,
        /// The control has begun a new epoch: nothing that was sent before can be taken any more, and the correction
        /// goes on from what is applied now.
        epoch_began: bool,
    },
}

/// The numbers of a report that a frame answers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Answered {
    /// The epoch of the report.
    pub epoch: u16,
    /// The tick of the report.
    pub tick: u16,
    /// The sequence of the report.
    pub sequence: u16,
}

/// What a sender knows of a barrier.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Session {
    /// The number that this sender drew at its start.
    pub owner: u16,
    /// The numbers of the last whole report, when frames may be sent.
    pub last: Option<Answered>,
    /// Epoch and sequence of the last frame.
    pub sent: Option<(u16, u16)>,
}

impl Session {
    /// A sender at its start. `owner` is drawn anew at each start, so that a sender does not take itself for the one
    /// that it was before; 0 stands for nobody and is taken as 1.
    #[must_use]
    pub fn new(owner: u16) -> Self {
        Self {
            owner: owner.max(1),
            last: None,
            sent: None,
        }
    }

    /// Takes a whole report, and says what it means.
    pub fn read(&mut self, report: &Report) -> Seen {
        let Report {
            epoch,
            tick,
            sequence,
            owner,
            ..
        } = *report;
        if self
            .last
            .is_some_and(|last| last.epoch == epoch && !is_ahead(tick, last.tick))
        {
            return Seen::Old;
        }
        if owner != 0 && owner != self.owner {
            self.last = None;
            self.sent = None;
            return Seen::Held { owner };
        }
        let epoch_began = self.last.is_none_or(|last| last.epoch != epoch);
        self.last = Some(Answered {
            epoch,
            tick,
            sequence,
        });
        Seen::Confirmed {
            landed: owner == self.owner && self.sent == Some((epoch, sequence)),
            epoch_began,
        }
    }

    /// Nothing was read for so long that the tick may have gone round: whatever report comes next is new.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// The frame that answers the last report with these values; `None` when there is no report to answer. To be sent
    /// at once: its age counts from the report.
    pub fn frame(&mut self, values: &Counts) -> Option<Frame> {
        let Answered {
            epoch,
            tick,
            sequence,
        } = self.last?;
        let sequence = sequence.wrapping_add(1);
        self.sent = Some((epoch, sequence));
        Some(Frame {
            epoch,
            tick,
            sequence,
            owner: self.owner,
            values: core::array::from_fn(|axis| values[axis]),
        })
    }
}
