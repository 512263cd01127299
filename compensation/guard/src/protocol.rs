//! The common part of all frames between a gateway and a control, whether they carry values (the [barrier](crate::barrier)) or a map that the
//! control evaluates itself (map mode of `volcomp-tables`).
//!
//! The wire is a black channel as in IEC 61784-3: frames may be lost, late, duplicated, reordered or torn. Each frame
//! answers the last report of the control. The control accepts the frame only while that report is recent, and only
//! from one sender at a time. [`Link`] is the control's half, [`Session`] the sender's half.
//!
//! Everything is in 16-bit words, the native type of a controller's own program. Nothing here allocates, waits or reads a clock: time is the number
//! of scans.

use volcomp_vocabulary::{AxisName, MAX_AXES};

/// One value per axis of a channel, in counts of that axis.
pub type Counts = volcomp_vocabulary::PerChannel<i16>;

/// Number of words of a [`Head`].
pub const HEAD_WORDS: usize = 4;

/// The head of a frame or of a report. The head of a frame states which report the frame answers: its fields are those
/// of the report, except where noted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Head {
    /// Epoch of the control.
    pub epoch: u16,
    /// Scan counter of the control. The control rejects a frame whose tick is more than `hold_scans` ago.
    pub tick: u16,
    /// In a report, the sequence of the last accepted frame; in a frame, the sequence in the answered report plus one.
    pub sequence: u16,
    /// In a report, the sender that owns the control; 0: none. In a frame, its sender: a random number drawn at the
    /// start of the sender, never 0.
    pub owner: u16,
}

impl Head {
    /// The words, in the order of the fields.
    #[must_use]
    pub fn words(self) -> [u16; HEAD_WORDS] {
        [self.epoch, self.tick, self.sequence, self.owner]
    }

    /// Decodes the words, in the order of the fields.
    #[must_use]
    pub fn of([epoch, tick, sequence, owner]: [u16; HEAD_WORDS]) -> Self {
        Self { epoch, tick, sequence, owner }
    }
}

/// Writes the checksum of all words but the last two into the last two.
pub fn seal(machine: u16, layout: Layout, words: &mut [u16]) {
    if let Some((body, check)) = words.split_last_chunk_mut() {
        *check = checksum(machine, layout, body).words();
    }
}

/// Whether the last two words are the checksum of the others.
#[must_use]
pub fn is_whole(machine: u16, layout: Layout, words: &[u16]) -> bool {
    (words.split_last_chunk())
        .is_some_and(|(body, check)| checksum(machine, layout, body).words() == *check)
}

/// Why a control rejected the last frame.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, thiserror::Error)]
pub enum Refusal {
    /// The last frame was accepted, or none was received yet.
    #[default]
    #[error("nothing was refused")]
    None,
    /// The frame is torn, or for another machine or another set of axes.
    #[error("its checksum does not fit")]
    Checksum,
    /// The frame is from before a restart or a timeout of the control.
    #[error("it belongs to an earlier epoch of the control")]
    Epoch,
    /// The frame answers a report that is older than the control allows.
    #[error("it was made from a report that is too old")]
    Tick,
    /// Another sender owns the control, or the frame names no sender.
    #[error("another sender holds the control")]
    Owner,
    /// A frame with a later sequence was accepted before.
    #[error("a later frame has overtaken it")]
    Sequence,
    /// A value exceeds the limit of the control for its axis. A map must be transferred from the
    /// start again.
    #[error("a value is beyond the limit of the control")]
    Value,
    /// A word on digital lines is rejected: a sender of frames owns the control, another correction is applied, the
    /// axis is not corrected, the word exceeds its limit, or the word changes faster than the configured rate.
    #[error("a word on the lines came at the wrong time, or changes too fast")]
    Lines,
    /// The words do not continue the map being loaded.
    #[error("its words are not the next ones of the map")]
    Place,
    /// The map does not fit the control: its axes, steps, size or lines. The map must be transferred from the start
    /// again.
    #[error("the map does not fit this control")]
    Fit,
    /// The checksum of the whole map does not match, or the map to be kept valid is not the active
    /// one.
    #[error("the map is not the one that is meant")]
    Map,
    /// The control does not support this kind of frame.
    #[error("its kind is unknown")]
    Kind,
}

impl Refusal {
    /// Index of this refusal in the list `all` of a control, as sent in its reports; 0 if the list lacks it.
    #[must_use]
    pub fn number_in(self, all: &[Self]) -> u16 {
        let place = all.iter().position(|one| *one == self).unwrap_or(0);
        u16::try_from(place).unwrap_or(0)
    }

    /// The refusal with this index in the list `all` of a control; `None` beyond its end.
    #[must_use]
    pub fn numbered(all: &[Self], number: u16) -> Option<Self> {
        all.get(usize::from(number)).copied()
    }
}

fn is_ahead(later: u16, earlier: u16) -> bool {
    (1..1 << 15).contains(&later.wrapping_sub(earlier))
}

/// Why axes are not a valid layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LayoutError {
    /// The list of axes is empty.
    #[error("number of axes: found 0, expected 1 to {MAX_AXES}")]
    NoAxes,
    /// An axis is named more than once.
    #[error("axis {axis}: found twice, expected once")]
    Twice {
        /// The repeated axis.
        axis: AxisName,
    },
}

/// The corrected axes in the order of the words. Its number seeds the checksum together with the machine number, so frames and reports for other
/// axes, or for the same axes in another order, do not match.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Layout {
    count: u8,
    number: u32,
}

impl Layout {
    /// The layout of these axes in this order.
    ///
    /// # Errors
    /// No axis, or a repeated one.
    pub fn of(axes: impl IntoIterator<Item = AxisName>) -> Result<Self, LayoutError> {
        let mut layout = Self { count: 0, number: 0 };
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

    /// Number of axes, 1 to [`MAX_AXES`].
    #[must_use]
    pub fn count(self) -> usize {
        self.count.into()
    }

    /// One decimal digit per axis, in order: X 1, Y 2, Z 3, A 4, B 5, C 6, U 7, V 8, W 9. The number of X Y Z is 123, that of X Y Z A C is 12346.
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
    /// The sum of the sums, which detects swapped words.
    pub of_sums: u16,
}

impl Checksum {
    #[must_use]
    pub fn words(self) -> [u16; 2] {
        [self.sum, self.of_sums]
    }
}

/// Fletcher checksum modulo 65535 of the words, seeded with the machine number and the layout number, so that a frame
/// for another machine, for other axes or for another axis order does not match. The checksum does not distinguish the
/// words 0 and 65535, that is 0 and −1 counts, a difference of one step of an axis.
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

/// The numbers that a control publishes, and with which it decides which frames to accept.
///
/// Invariants:
/// - An epoch is never reused within 65,536 starts and timeouts.
/// - `silent` grows only without an accepted frame, and not beyond the timeout, at which `owner` is free.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Link {
    /// Incremented at each start and at each timeout.
    pub epoch: u16,
    /// Scan counter, which wraps.
    pub tick: u16,
    /// The only sender whose frames are accepted; 0: any.
    pub owner: u16,
    /// Sequence of the last accepted frame.
    pub sequence: u16,
    /// Scans since a frame was accepted; the count stops at the timeout.
    pub silent: u16,
}

impl Link {
    /// The link of a control after power-up or a reset. `epoch` is the retained epoch. It is incremented here, so that
    /// no earlier frame can be accepted.
    #[must_use]
    pub fn start(epoch: u16, tick: u16) -> Self {
        Self { epoch: epoch.wrapping_add(1), tick, ..Self::default() }
    }

    /// Counts a scan.
    pub fn scan(&mut self) {
        self.tick = self.tick.wrapping_add(1);
    }

    /// Checks the head of a complete frame. Returns `true` if the control is to accept the frame, provided that its
    /// content is valid; `false` if the frame was checked before, or is the last accepted frame.
    ///
    /// `found` is the tick and sequence of the last complete frame in the same mailbox. A frame that is not overwritten
    /// stays in the mailbox; without this check it would be accepted again once tick and sequence have wrapped.
    ///
    /// # Errors
    ///
    /// Why the frame is rejected.
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

    /// Accepts a frame: its sender owns the control from now on.
    pub fn take(&mut self, head: Head) {
        self.owner = head.owner;
        self.sequence = head.sequence;
    }

    /// Counts a scan without an accepted frame. Returns true in the scan of the timeout only: the control is then
    /// released and begins a new epoch, so that no earlier frame can be accepted any more.
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

/// Result of a report for the sender that received it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ReportStatus {
    /// The scan counter has not advanced since the last report, or this report is older.
    Old,
    /// Another sender owns the control, or a predecessor of this sender did: nothing may be sent until the timeout of
    /// the control. Also returned for the owner number of this sender, if this sender has not sent the reported
    /// sequence in this epoch.
    Held {
        /// Owner number of the other sender.
        owner: u16,
    },
    /// A complete, new report: its correction is confirmed.
    Confirmed {
        /// Whether the last sent frame was accepted.
        landed: bool,
        /// Whether the control has begun a new epoch: no earlier frame can be accepted any more,
        /// and the correction continues from the applied one.
        epoch_began: bool,
    },
}

/// Number of epochs whose frames a sender remembers: a late report belongs to one of these epochs.
const MOST_EPOCHS: usize = 4;

/// A sender's record of the reports that it received from a control, and of the frames that it sent.
///
/// Invariants:
/// - `last` is set only while this sender may send. `sent` is the frame that answered the latest answered report.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Session {
    /// Random number drawn by this sender at its start.
    pub owner: u16,
    /// Head of the last complete report, if frames may be sent.
    pub last: Option<Head>,
    /// Epoch and sequence of the last sent frame.
    pub sent: Option<(u16, u16)>,
    /// Latest sequence of this sender's frames, on any path, in each of the last epochs with frames of this sender.
    /// Each epoch occurs once.
    pub own: [Option<(u16, u16)>; MOST_EPOCHS],
}

impl Session {
    /// A sender at its start. `owner` must be a new random number at each start, so that a sender does not mistake its predecessor for itself; 0
    /// means none and is replaced by 1.
    #[must_use]
    pub fn new(owner: u16) -> Self {
        Self { owner: owner.max(1), last: None, sent: None, own: [None; MOST_EPOCHS] }
    }

    /// Processes the head of a complete report.
    pub fn read(&mut self, report: Head) -> ReportStatus {
        let Head { epoch, tick, sequence, owner } = report;
        if self.last.is_some_and(|last| last.epoch == epoch && !is_ahead(tick, last.tick)) {
            return ReportStatus::Old;
        }
        if owner != 0 && (owner != self.owner || !self.has_sent(epoch, sequence)) {
            self.last = None;
            self.sent = None;
            return ReportStatus::Held { owner };
        }
        let epoch_began = self.last.is_none_or(|last| last.epoch != epoch);
        self.last = Some(report);
        ReportStatus::Confirmed {
            landed: owner == self.owner && self.sent == Some((epoch, sequence)),
            epoch_began,
        }
    }

    /// Records a frame of this sender, on this or another path.
    pub fn sends(&mut self, epoch: u16, sequence: u16) {
        if let Some((_, newest)) = self.own.iter_mut().flatten().find(|own| own.0 == epoch) {
            if is_ahead(sequence, *newest) {
                *newest = sequence;
            }
            return;
        }
        // The oldest epoch is replaced, unless it is newer than `epoch`.
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

    /// Whether this sender may have sent this sequence in this epoch. Lost frames count as sent, and so do all frames
    /// older than the remembered epochs.
    fn has_sent(&self, epoch: u16, sequence: u16) -> bool {
        let mut own = self.own.iter().flatten();
        match own.clone().find(|own| own.0 == epoch) {
            Some((_, newest)) => !is_ahead(sequence, *newest),
            None => own.clone().next().is_some() && !own.any(|(known, _)| is_ahead(epoch, *known)),
        }
    }

    /// Accepts any next report as new, because the tick may have wrapped since the last one.
    pub fn forget(&mut self) {
        self.last = None;
    }

    /// The head of the frame that answers the last report; `None` without a report to answer. Send the frame at once:
    /// its age counts from the report.
    pub fn answer(&mut self) -> Option<Head> {
        let last = self.last?;
        let head = Head { sequence: last.sequence.wrapping_add(1), owner: self.owner, ..last };
        self.sent = Some((head.epoch, head.sequence));
        self.sends(head.epoch, head.sequence);
        Some(head)
    }
}
