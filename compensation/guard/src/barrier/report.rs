//! The report that a barrier publishes.

use volcomp_vocabulary::MAX_AXES;

use super::Settings;
use crate::protocol::{Counts, Head, Layout, Refusal, is_whole, seal};

/// The largest number of words of a report: head, three values for each axis, checksum.
pub const REPORT_WORDS: usize = HEAD + 3 * MAX_AXES + 2;

/// Epoch, tick, owner, sequence, refusal, scans from step to step, hold, time-out.
const HEAD: usize = 8;

/// The refusals of a barrier, by their numbers in its words.
const REFUSALS: [Refusal; 8] = [
    Refusal::None,
    Refusal::Checksum,
    Refusal::Epoch,
    Refusal::Tick,
    Refusal::Owner,
    Refusal::Sequence,
    Refusal::Value,
    Refusal::Lines,
];

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

    /// The numbers that a frame answers.
    #[must_use]
    pub fn head(&self) -> Head {
        Head {
            epoch: self.epoch,
            tick: self.tick,
            sequence: self.sequence,
            owner: self.owner,
        }
    }

    /// Writes the words of the report, checksum and all, and tells how many there are.
    pub fn encode(&self, words: &mut [u16; REPORT_WORDS]) -> usize {
        let s = &self.settings;
        let length = Self::length(s.axes);
        words[..HEAD].copy_from_slice(&[
            self.epoch,
            self.tick,
            self.owner,
            self.sequence,
            self.refusal.number_in(&REFUSALS),
            s.step_scans,
            s.hold_scans,
            s.time_out_scans,
        ]);
        for axis in 0..s.axes.count() {
            let three = [self.applied[axis], s.limit[axis], s.rate[axis]];
            words[HEAD + 3 * axis..][..3].copy_from_slice(&three.map(i16::cast_unsigned));
        }
        seal(s.machine, s.axes, &mut words[..length]);
        length
    }

    /// Reads the report of a barrier for this machine and these axes; `None` when there are too few words, the checksum
    /// does not fit, or the barrier's settings make no sense.
    #[must_use]
    pub fn decode(machine: u16, axes: Layout, words: &[u16]) -> Option<Self> {
        let words = words.get(..Self::length(axes))?;
        if !is_whole(machine, axes, words) {
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
            refusal: Refusal::numbered(&REFUSALS, words[4])?,
            applied,
            settings,
        })
    }
}
