//! The sender's side: what a report says, and the frame that answers it.

use super::{Head, is_ahead};

/// What a report means for a sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Seen {
    /// The control's scans did not move on since the last report, or this one is from before it: it says nothing new.
    Old,
    /// Another sender holds the control, or this one did before its restart: nothing may be sent until the control's
    /// time-out has set it free. Also where the number is that of this sender, which has not sent that sequence in that epoch.
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

/// The number of epochs whose frames a sender remembers: a report that was late is of one of these.
const MOST_EPOCHS: usize = 4;

/// What a sender knows of a control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Session {
    /// The number that this sender drew at its start.
    pub owner: u16,
    /// The numbers of the last whole report, when frames may be sent.
    pub last: Option<Head>,
    /// Epoch and sequence of the last frame.
    pub sent: Option<(u16, u16)>,
    /// The newest sequence of this sender's frames in each of the last epochs in which it sent any, by whatever path. Each epoch is
    /// there once.
    pub own: [Option<(u16, u16)>; MOST_EPOCHS],
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
            own: [None; MOST_EPOCHS],
        }
    }

    /// Takes the numbers of a whole report, and says what they mean.
    pub fn read(&mut self, report: Head) -> Seen {
        let Head {
            epoch,
            tick,
            sequence,
            owner,
        } = report;
        if self
            .last
            .is_some_and(|last| last.epoch == epoch && !is_ahead(tick, last.tick))
        {
            return Seen::Old;
        }
        if owner != 0 && (owner != self.owner || !self.has_sent(epoch, sequence)) {
            self.last = None;
            self.sent = None;
            return Seen::Held { owner };
        }
        let epoch_began = self.last.is_none_or(|last| last.epoch != epoch);
        self.last = Some(report);
        Seen::Confirmed {
            landed: owner == self.owner && self.sent == Some((epoch, sequence)),
            epoch_began,
        }
    }

    /// Records a frame of this sender, also one that went by another path.
    pub fn sends(&mut self, epoch: u16, sequence: u16) {
        if let Some((_, newest)) = self.own.iter_mut().flatten().find(|own| own.0 == epoch) {
            if is_ahead(sequence, *newest) {
                *newest = sequence;
            }
            return;
        }
        // The oldest epoch makes room, unless it is newer than this one.
        let mut oldest = 0;
        for place in 1..MOST_EPOCHS {
            oldest = match (self.own[place], self.own[oldest]) {
                (None, Some(_)) => place,
                (Some((epoch, _)), Some((other, _))) if is_ahead(other, epoch) => place,
                _ => oldest,
            };
        }
        if self.own[oldest].is_none_or(|(known, _)| is_ahead(epoch, known)) {
            self.own[oldest] = Some((epoch, sequence));
        }
    }

    /// Whether this sender has sent this sequence in this epoch, as far as it remembers: frames that were lost count, and so does
    /// what is older than all epochs that it remembers.
    fn has_sent(&self, epoch: u16, sequence: u16) -> bool {
        let mut own = self.own.iter().flatten();
        match own.clone().find(|own| own.0 == epoch) {
            Some((_, newest)) => !is_ahead(sequence, *newest),
            None => own.clone().next().is_some() && !own.any(|(known, _)| is_ahead(epoch, *known)),
        }
    }

    /// Nothing was read for so long that the tick may have gone round: whatever report comes next is new.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// The head of the frame that answers the last report; `None` when there is no report to answer. To be sent at once: its age
    /// counts from the report.
    pub fn answer(&mut self) -> Option<Head> {
        let last = self.last?;
        let head = Head {
            sequence: last.sequence.wrapping_add(1),
            owner: self.owner,
            ..last
        };
        self.sent = Some((head.epoch, head.sequence));
        self.sends(head.epoch, head.sequence);
        Some(head)
    }
}
