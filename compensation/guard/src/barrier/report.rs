//! The report that a barrier publishes.

use volcomp_vocabulary::MAX_AXES;

use super::{Counts, Layout, Settings, checksum};

/// The largest number of words of a report: head, three values for each axis, checksum.
pub const REPORT_WORDS: usize = HEAD + 3 * MAX_AXES + 2;

/// Epoch, tick, owner, sequence, refusal, scans from step to step, hold, time-out.
const HEAD: usize = 8;

/// Why the last frame was not taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, thiserror::Error)]
#[repr(u16)]
pub enum Refusal {
    /// Every frame so far was taken.
    #[default]
    #[error("nothing was refused")]
    None = 0,
    /// The frame is torn, or meant for another machine or another set of axes.
    #[error("its checksum does not fit")]
    Checksum = 1,
    /// The frame was made before the control started anew or timed out.
    #[error("it belongs to an earlier epoch of the control")]
    Epoch = 2,
    /// The frame was made from a report that is older than the control allows.
    #[error("it was made from a report that is too old")]
    Tick = 3,
    /// Another sender holds the control.
    #[error("another sender holds the control")]
    Owner = 4,
    /// The frame was overtaken by a later one.
    #[error("a later frame has overtaken it")]
    Sequence = 5,
    /// A value lies beyond the limit that the control has for the axis.
    #[error("a value lies beyond the limit of the control")]
    Value = 6,
    /// A word on plain lines came while a sender of frames holds the control or another correction is applied, or it
    /// changes faster than the axis could follow.
    #[error("a word on the lines came at the wrong time, or changes too fast")]
    Lines = 7,
}

impl Refusal {
    /// The refusal of this number.
    fn of(number: u16) -> Option<Self> {
        Some(match number {
            0 => Self::None,
            1 => Self::Checksum,
            2 => Self::Epoch,
            3 => Self::Tick,
            4 => Self::Owner,
            5 => Self::Sequence,
            6 => Self::Value,
            7 => Self::Lines,
            _ => return None,
        })
    }
}

/// What a barrier publishes after each scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Report {
    /// Moves on when the control starts or the time-out ends the correction; kept over power-off.
    pub epoch: u16,
    /// The number of scans of the control.
    pub tick: u16,
    /// The sender whose frames are taken; 0: anybody's.
    pub owner: u16,
    /// The sequence of the last frame that was taken.
    pub sequence: u16,
    /// Why the last frame was not taken.
    pub refusal: Refusal,
    /// The correction that is applied to each axis now, counts.
    pub applied: Counts,
    /// The limits, rates and times of the barrier. The machine's number is not in the words: it starts the checksum.
    pub settings: Settings,
}

impl Report {
    /// The number of words that a report of so many axes has.
    #[must_use]
    pub fn length(axes: Layout) -> usize {
        HEAD + 3 * axes.count() + 2
    }

    /// Writes the words of the report, checksum and all, and tells how many there are.
    pub fn encode(&self, words: &mut [u16; REPORT_WORDS]) -> usize {
        let s = &self.settings;
        let body = Self::length(s.axes) - 2;
        words[..HEAD].copy_from_slice(&[
            self.epoch,
            self.tick,
            self.owner,
            self.sequence,
            self.refusal as u16,
            s.step_scans,
            s.hold_scans,
            s.time_out_scans,
        ]);
        for axis in 0..s.axes.count() {
            let three = [self.applied[axis], s.limit[axis], s.rate[axis]];
            words[HEAD + 3 * axis..][..3].copy_from_slice(&three.map(i16::cast_unsigned));
        }
        let check = checksum(s.machine, s.axes, &words[..body]);
        words[body] = check.sum;
        words[body + 1] = check.of_sums;
        body + 2
    }

    /// Reads the report of a barrier for this machine and these axes; `None` when there are too few words, the checksum
    /// does not fit, or the barrier's settings make no sense.
    #[must_use]
    pub fn decode(machine: u16, axes: Layout, words: &[u16]) -> Option<Self> {
        let body = Self::length(axes) - 2;
        let words = words.get(..body + 2)?;
        let check = checksum(machine, axes, &words[..body]);
        if [check.sum, check.of_sums] != words[body..] {
            return None;
        }
        let mut settings = Settings {
            axes,
            machine,
            limit: Counts::default(),
            rate: Counts::default(),
            step_scans: words[5],
            hold_scans: words[6],
            time_out_scans: words[7],
        };
        let mut applied = Counts::default();
        for axis in 0..axes.count() {
            let at = HEAD + 3 * axis;
            applied[axis] = words[at].cast_signed();
            settings.limit[axis] = words[at + 1].cast_signed();
            settings.rate[axis] = words[at + 2].cast_signed();
        }
        settings.check().ok()?;
        Some(Self {
            epoch: words[0],
            tick: words[1],
            owner: words[2],
            sequence: words[3],
            refusal: Refusal::of(words[4])?,
            applied,
            settings,
        })
    }
}
