//! What every frame between a gateway and a control has in common, whether it brings values (the [barrier](crate::barrier)) or a
//! map that the control looks up itself (map mode of `volcomp-tables`).
//!
//! The wire is taken as a black channel, as in IEC 61784-3: frames may be lost, late, doubled, reordered or torn. Each frame
//! answers the last report of the control, which takes it only while that report is recent, and only from one sender at a time:
//! [`Link`] is the control's half, [`Session`] the sender's.
//!
//! Everything is 16-bit words, because that is what a controller's own program has. Nothing here allocates, waits or reads a
//! clock: the time is the number of scans.

use volcomp_vocabulary::{AxisName, MAX_AXES};

/// One value for each axis of a channel, in counts of that axis.
pub type Counts = volcomp_vocabulary::PerChannel<i16>;

/// Words of a [`Head`].
pub const HEAD_WORDS: usize = 4;

/// How a frame begins: what shows that it is meant for now.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Head {
    /// The epoch that the control published last.
    pub epoch: u16,
    /// The tick that the control published last: how old the sender's knowledge is.
    pub tick: u16,
    /// One more than the sequence that the control published last.
    pub sequence: u16,
    /// The number that the sender drew at its start, never 0.
    pub owner: u16,
}

impl Head {
    /// The words, in the order of the fields.
    #[must_use]
    pub fn words(self) -> [u16; HEAD_WORDS] {
        [self.epoch, self.tick, self.sequence, self.owner]
    }

    /// The head of these words.
    #[must_use]
    pub fn of([epoch, tick, sequence, owner]: [u16; HEAD_WORDS]) -> Self {
        Self {
            epoch,
            tick,
            sequence,
            owner,
        }
    }
}

/// Writes the checksum of the words before the last two into those.
pub fn seal(machine: u16, layout: Layout, words: &mut [u16]) {
    if let Some((body, check)) = words.split_last_chunk_mut() {
        *check = checksum(machine, layout, body).words();
    }
}

/// Whether the last two words are the checksum of those before.
#[must_use]
pub fn is_whole(machine: u16, layout: Layout, words: &[u16]) -> bool {
    (words.split_last_chunk())
        .is_some_and(|(body, check)| checksum(machine, layout, body).words() == *check)
}

/// Why a control did not take the last frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Refusal {
    /// Every frame so far was taken.
    #[default]
    #[error("nothing was refused")]
    None,
    /// The frame is torn, or meant for another machine or another set of axes.
    #[error("its checksum does not fit")]
    Checksum,
    /// The frame was made before the control started anew or timed out.
    #[error("it belongs to an earlier epoch of the control")]
    Epoch,
    /// The frame was made from a report that is older than the control allows.
    #[error("it was made from a report that is too old")]
    Tick,
    /// Another sender holds the control, or the frame names none.
    #[error("another sender holds the control")]
    Owner,
    /// The frame was overtaken by a later one.
    #[error("a later frame has overtaken it")]
    Sequence,
    /// A value is beyond the limit that the control has for the axis. A map has to be begun again.
    #[error("a value is beyond the limit of the control")]
    Value,
    /// A word on plain lines came while a sender of frames holds the control or another correction is applied, or it
    /// changes faster than the axis could follow.
    #[error("a word on the lines came at the wrong time, or changes too fast")]
    Lines,
    /// Words that are not the next ones of the map that is being loaded.
    #[error("its words are not the next ones of the map")]
    Place,
    /// The map does not fit the control: its axes, its steps, its size or its lines. It has to be begun again.
    #[error("the map does not fit this control")]
    Fit,
    /// The checksum of the whole map does not fit, or the map that is to be kept is not the one in use.
    #[error("the map is not the one that is meant")]
    Map,
    /// A kind of frame that this control does not know.
    #[error("its kind is unknown")]
    Kind,
}

impl Refusal {
    /// Its number in the reports of a control whose refusals are these, from 0.
    #[must_use]
    pub fn number_in(self, all: &[Self]) -> u16 {
        let place = all.iter().position(|one| *one == self).unwrap_or(0);
        u16::try_from(place).unwrap_or(0)
    }

    /// The refusal of a number.
    #[must_use]
    pub fn numbered(all: &[Self], number: u16) -> Option<Self> {
        all.get(usize::from(number)).copied()
    }
}

/// Whether `later` lies ahead of `earlier` on a counter of 16 bits that wraps around: by less than half of its range.
fn is_ahead(later: u16, earlier: u16) -> bool {
    (1..1 << 15).contains(&later.wrapping_sub(earlier))
}

/// Why axes make no layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LayoutError {
    /// There is no axis.
    #[error("number of axes: found 0, expected 1 to {MAX_AXES}")]
    NoAxes,
    /// An axis that is named more than once.
    #[error("axis {axis}: found twice, expected once")]
    Twice {
        /// The axis that was found again.
        axis: AxisName,
    },
}

/// The corrected axes in the order of its words. Its number starts the checksum together with the machine's, so that
/// frames and reports for other axes, or for the same axes in another order, do not fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Layout {
    count: u8,
    number: u32,
}

impl Layout {
    /// The layout of these axes in this order.
    ///
    /// # Errors
    /// No axis, or one that is named twice.
    pub fn of(axes: impl IntoIterator<Item = AxisName>) -> Result<Self, LayoutError> {
        let mut layout = Self {
            count: 0,
            number: 0,
        };
        let mut seen = [false; MAX_AXES];
        for axis in axes {
            if core::mem::replace(&mut seen[axis.index()], true) {
                return Err(LayoutError::Twice { axis });
            }
            layout.count += 1;
            layout.number = 10 * layout.number + digit(axis);
        }
        if layout.count == 0 {
            return Err(LayoutError::NoAxes);
        }
        Ok(layout)
    }

    /// How many axes there are, 1 to [`MAX_AXES`].
    #[must_use]
    pub fn count(self) -> usize {
        self.count.into()
    }

    /// One decimal digit for each axis, in their order: X 1, Y 2, Z 3, A 4, B 5, C 6, U 7, V 8, W 9. The number of
    /// X Y Z is 123, that of X Y Z A C is 12346.
    #[must_use]
    pub fn number(self) -> u32 {
        self.number
    }
}

fn digit(name: AxisName) -> u32 {
    match name {
        AxisName::X => 1,
        AxisName::Y => 2,
        AxisName::Z => 3,
        AxisName::A => 4,
        AxisName::B => 5,
        AxisName::C => 6,
        AxisName::U => 7,
        AxisName::V => 8,
        AxisName::W => 9,
    }
}

/// The two sums of a Fletcher checksum over 16-bit words.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Checksum {
    /// The sum of the words.
    pub sum: u16,
    /// The sum of the sums, which detects words that changed places.
    pub of_sums: u16,
}

impl Checksum {
    /// The sum, and the sum of the sums.
    #[must_use]
    pub fn words(self) -> [u16; 2] {
        [self.sum, self.of_sums]
    }
}

/// Fletcher's checksum modulo 65535 of the words, started from the machine's number and the layout's, so that a frame for
/// another machine, for other axes or for another order of them does not fit. The words 0 and 65535 weigh the same: -1 and 0 counts
/// cannot be distinguished by it, which is at most one step of an axis.
#[must_use]
pub fn checksum(machine: u16, layout: Layout, words: &[u16]) -> Checksum {
    let reduced = |sum: u32| u16::try_from(sum % 65535).unwrap_or(0);
    let mut check = Checksum {
        sum: reduced(u32::from(machine) + layout.number() / 65535),
        of_sums: reduced(layout.number()),
    };
    for word in words {
        check.sum = reduced(u32::from(check.sum) + u32::from(*word));
        check.of_sums = reduced(u32::from(check.of_sums) + u32::from(check.sum));
    }
    check
}

/// The numbers that a control publishes and by which it takes frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Link {
    /// Moves on at each start and at each time-out.
    pub epoch: u16,
    /// The number of scans, which wraps around.
    pub tick: u16,
    /// The sender whose frames are taken; 0: any.
    pub owner: u16,
    /// The sequence of the last frame that was taken.
    pub sequence: u16,
    /// The number of scans since a frame was taken; it stops at the time-out.
    pub silent: u16,
}

impl Link {
    /// The link of a control after power-up or a reset. `epoch` is the one that was kept over power-off: it moves on here, so
    /// that no frame made before can be taken.
    #[must_use]
    pub fn start(epoch: u16, tick: u16) -> Self {
        Self {
            epoch: epoch.wrapping_add(1),
            tick,
            ..Self::default()
        }
    }

    /// Counts a scan.
    pub fn scan(&mut self) {
        self.tick = self.tick.wrapping_add(1);
    }

    /// Whether a whole frame is to be taken, if its content can be; `false`: it was judged before, or is the one that was taken
    /// last.
    ///
    /// `found` are tick and sequence of the whole frame that was found last in the same mailbox. A frame that is not overwritten
    /// lies there for ever: judged again it would be taken once tick and sequence have gone round.
    ///
    /// # Errors
    /// Why it is refused.
    pub fn judge(
        &self,
        head: Head,
        found: &mut Option<(u16, u16)>,
        hold_scans: u16,
    ) -> Result<bool, Refusal> {
        let this = Some((head.tick, head.sequence));
        if core::mem::replace(found, this) == this {
            return Ok(false);
        }
        let is_held = self.owner != 0;
        if head.epoch != self.epoch {
            return Err(Refusal::Epoch);
        }
        if head.owner == 0 || is_held && head.owner != self.owner {
            return Err(Refusal::Owner);
        }
        if is_held && head.sequence == self.sequence {
            return Ok(false);
        }
        if self.tick.wrapping_sub(head.tick) > hold_scans {
            return Err(Refusal::Tick);
        }
        if is_held && !is_ahead(head.sequence, self.sequence) {
            return Err(Refusal::Sequence);
        }
        Ok(true)
    }

    /// Takes a frame: from now on its sender holds the control.
    pub fn take(&mut self, head: Head) {
        self.owner = head.owner;
        self.sequence = head.sequence;
    }

    /// Counts a scan in which no frame was taken. At the time-out, once, it sets the control free, begins a new epoch, so that no
    /// frame that was made before can be taken any more, and says so.
    pub fn is_timed_out(&mut self, time_out_scans: u16) -> bool {
        if self.silent >= time_out_scans {
            return false;
        }
        self.silent += 1;
        let is_over = self.silent == time_out_scans;
        if is_over {
            self.epoch = self.epoch.wrapping_add(1);
            self.owner = 0;
        }
        is_over
    }
}

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
    /// A whole, new report: the correction in it is confirmed.
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
    /// that it was before; 0 means none and is taken as 1.
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

    /// Nothing was read until the tick may have gone round: whatever report comes next is new.
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
