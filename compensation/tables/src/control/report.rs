//! What a control with a map publishes.

use volcomp_guard::barrier::checksum;

use super::Settings;
use crate::OUTPUTS;

/// The largest number of words of a report.
pub const REPORT_WORDS: usize = HEAD + 3 * OUTPUTS + 2;

const HEAD: usize = 13;
/// No map is being loaded.
const NOTHING: u16 = u16::MAX;

/// Why the last frame was not taken.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, thiserror::Error)]
#[repr(u16)]
pub enum Refusal {
    /// Every frame so far was taken.
    #[default]
    #[error("nothing was refused")]
    None = 0,
    /// The frame is torn, or meant for another machine or other axes.
    #[error("its checksum does not fit")]
    Checksum = 1,
    /// The frame was made before the control started anew or timed out.
    #[error("it belongs to an earlier epoch of the control")]
    Epoch = 2,
    /// The frame was made from a report that is older than the control allows.
    #[error("it was made from a report that is too old")]
    Tick = 3,
    /// Another sender holds the control, or the frame names none.
    #[error("another sender holds the control")]
    Owner = 4,
    /// The frame is not ahead of the last one that was taken.
    #[error("its sequence is behind")]
    Sequence = 5,
    /// A value of the map is beyond the limit of its axis. The map has to be begun again.
    #[error("a value of the map is beyond the limit of its axis")]
    Value = 6,
    /// Words that are not the next ones of the map that is being loaded.
    #[error("it is not what comes next")]
    Place = 7,
    /// The map does not fit the control: its axes, its steps, its size or its lines. It has to be begun again.
    #[error("the map does not fit this control")]
    Fit = 8,
    /// The checksum of the whole map does not fit, or the map that is to be kept is not the one in use.
    #[error("the map is not the one that is meant")]
    Map = 9,
    /// A kind of frame that this control does not know.
    #[error("its kind is unknown")]
    Kind = 10,
}

impl Refusal {
    fn of(number: u16) -> Option<Self> {
        [
            Self::None,
            Self::Checksum,
            Self::Epoch,
            Self::Tick,
            Self::Owner,
            Self::Sequence,
            Self::Value,
            Self::Place,
            Self::Fit,
            Self::Map,
            Self::Kind,
        ]
        .get(usize::from(number))
        .copied()
    }
}

/// What a control with a map publishes after each scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Moves on at each start and at each time-out.
    pub epoch: u16,
    /// The number of scans, which wraps around.
    pub tick: u16,
    /// The sender whose frames are taken; 0: anybody's.
    pub owner: u16,
    /// The sequence of the last frame that was taken.
    pub sequence: u16,
    /// Why the last frame was not taken.
    pub refusal: Refusal,
    /// A map is in use. Where it is not, the corrections are zero or on the way there.
    pub valid: bool,
    /// The number of the map that is or was in use last; 0: none since the start.
    pub counter: u16,
    /// The number of the map that is being loaded, and the place of the word that comes next.
    pub loading: Option<(u16, u16)>,
    /// Which of the two buffers the map in use lies in, 0 or 1.
    pub buffer: u16,
    /// The corrections that are applied, steps.
    pub applied: [i16; OUTPUTS],
    /// Scans from one movement to the next.
    pub step_scans: u16,
    /// The largest age of what a frame answers, scans.
    pub hold_scans: u16,
    /// Scans without a frame after which the correction goes to zero.
    pub time_out_scans: u16,
    /// The largest correction of each output, steps.
    pub limit: [i16; OUTPUTS],
    /// The largest movement of each output at once, steps.
    pub rate: [i16; OUTPUTS],
}

impl Report {
    /// How many words a report of these settings has.
    #[must_use]
    pub fn length(settings: &Settings) -> usize {
        HEAD + 3 * settings.outputs.count().min(OUTPUTS) + 2
    }

    /// Writes the words, and tells how many there are.
    pub fn encode(&self, settings: &Settings, words: &mut [u16; REPORT_WORDS]) -> usize {
        let (loading, next) = self.loading.unwrap_or((0, NOTHING));
        words[..HEAD].copy_from_slice(&[
            self.epoch,
            self.tick,
            self.owner,
            self.sequence,
            self.refusal as u16,
            self.valid.into(),
            self.counter,
            loading,
            next,
            self.buffer,
            self.step_scans,
            self.hold_scans,
            self.time_out_scans,
        ]);
        let outputs = settings.outputs.count().min(OUTPUTS);
        for (place, of) in [self.applied, self.limit, self.rate].iter().enumerate() {
            for output in 0..outputs {
                words[HEAD + outputs * place + output] = of[output].cast_unsigned();
            }
        }
        let body = HEAD + 3 * outputs;
        let check = checksum(settings.machine, settings.outputs, &words[..body]);
        words[body..body + 2].copy_from_slice(&[check.sum, check.of_sums]);
        body + 2
    }

    /// Reads a report; `None` when there are too few words, the checksum does not fit, or a word means nothing.
    #[must_use]
    pub fn decode(settings: &Settings, words: &[u16]) -> Option<Self> {
        let outputs = settings.outputs.count().min(OUTPUTS);
        let body = HEAD + 3 * outputs;
        let words = words.get(..body + 2)?;
        let check = checksum(settings.machine, settings.outputs, &words[..body]);
        if [check.sum, check.of_sums] != words[body..] || words[5] > 1 || words[9] > 1 {
            return None;
        }
        let values = |place: usize| {
            core::array::from_fn(|output| {
                if output < outputs {
                    words[HEAD + outputs * place + output].cast_signed()
                } else {
                    0
                }
            })
        };
        Some(Self {
            epoch: words[0],
            tick: words[1],
            owner: words[2],
            sequence: words[3],
            refusal: Refusal::of(words[4])?,
            valid: words[5] == 1,
            counter: words[6],
            loading: (words[8] != NOTHING).then_some((words[7], words[8])),
            buffer: words[9],
            step_scans: words[10],
            hold_scans: words[11],
            time_out_scans: words[12],
            applied: values(0),
            limit: values(1),
            rate: values(2),
        })
    }
}
