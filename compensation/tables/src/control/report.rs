//! What a control with a map publishes.

use volcomp_guard::{
    barrier,
    protocol::{Counts, Layout, Refusal, is_whole, seal},
};

use crate::OUTPUTS;

/// The largest number of words of a report.
pub const REPORT_WORDS: usize = HEAD + 3 * OUTPUTS + 2;

const HEAD: usize = 13;
/// No map is being loaded.
const NOTHING: u16 = u16::MAX;

/// The refusals of a look-up, by their numbers in its words.
const REFUSALS: [Refusal; 11] = [
    Refusal::None,
    Refusal::Checksum,
    Refusal::Epoch,
    Refusal::Tick,
    Refusal::Owner,
    Refusal::Sequence,
    Refusal::Value,
    Refusal::Place,
    Refusal::Fit,
    Refusal::Map,
    Refusal::Kind,
];

/// What a control with a map publishes after each scan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Report {
    /// Its link, and what is applied: as of a barrier.
    pub of: barrier::Report,
    /// A map is in use. Where it is not, the corrections are zero or on the way there.
    pub valid: bool,
    /// The number of the map that is or was in use last; 0: none since the start.
    pub counter: u16,
    /// The number of the map that is being loaded, and the place of the word that comes next.
    pub loading: Option<(u16, u16)>,
    /// Which of the two buffers the map in use lies in, 0 or 1.
    pub buffer: u16,
}

impl Report {
    /// How many words a report of these corrected axes has.
    #[must_use]
    pub fn length(outputs: Layout) -> usize {
        HEAD + 3 * outputs.count().min(OUTPUTS) + 2
    }

    /// Writes the words, and tells how many there are.
    pub fn encode(&self, words: &mut [u16; REPORT_WORDS]) -> usize {
        let (loading, next) = self.loading.unwrap_or((0, NOTHING));
        let (of, settings) = (&self.of, &self.of.settings);
        words[..HEAD].copy_from_slice(&[
            of.epoch,
            of.tick,
            of.owner,
            of.sequence,
            of.refusal.number_in(&REFUSALS),
            self.valid.into(),
            self.counter,
            loading,
            next,
            self.buffer,
            settings.step_scans,
            settings.hold_scans,
            settings.time_out_scans,
        ]);
        let outputs = settings.axes.count().min(OUTPUTS);
        for (place, of) in [of.applied, settings.limit, settings.rate]
            .iter()
            .enumerate()
        {
            for output in 0..outputs {
                words[HEAD + outputs * place + output] = of[output].cast_unsigned();
            }
        }
        let length = Self::length(settings.axes);
        seal(settings.machine, settings.axes, &mut words[..length]);
        length
    }

    /// Reads a report of this machine and these corrected axes; `None` when there are too few words, the checksum does not fit, or a
    /// word means nothing.
    #[must_use]
    pub fn decode(machine: u16, axes: Layout, words: &[u16]) -> Option<Self> {
        let words = words.get(..Self::length(axes))?;
        if !is_whole(machine, axes, words) || words[5] > 1 || words[9] > 1 {
            return None;
        }
        let outputs = axes.count().min(OUTPUTS);
        let values = |place: usize| {
            Counts::from_fn(|output| {
                if output < outputs {
                    words[HEAD + outputs * place + output].cast_signed()
                } else {
                    0
                }
            })
        };
        let settings = barrier::Settings {
            axes,
            machine,
            limit: values(1),
            rate: values(2),
            step_scans: words[10],
            hold_scans: words[11],
            time_out_scans: words[12],
        };
        Some(Self {
            of: barrier::Report {
                epoch: words[0],
                tick: words[1],
                owner: words[2],
                sequence: words[3],
                refusal: Refusal::numbered(&REFUSALS, words[4])?,
                applied: values(0),
                settings,
            },
            valid: words[5] == 1,
            counter: words[6],
            loading: (words[8] != NOTHING).then_some((words[7], words[8])),
            buffer: words[9],
        })
    }
}
