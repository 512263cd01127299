//! The frame that a gateway sends.

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use super::{Counts, Settings, checksum};

/// The largest number of words of a frame: head, one value for each axis, checksum.
pub const FRAME_WORDS: usize = HEAD + MAX_AXES + 2;

/// Epoch, tick, sequence, owner.
const HEAD: usize = 4;

/// The frame of one cycle: the wanted correction and what shows that it is meant for now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Frame {
    /// The epoch that the barrier published last.
    pub epoch: u16,
    /// The tick that the barrier published last: how old the sender's knowledge is.
    pub tick: u16,
    /// One more than the sequence that the barrier published last.
    pub sequence: u16,
    /// The number that the sender drew at its start, never 0.
    pub owner: u16,
    /// The wanted correction of each axis, counts.
    pub values: [i16; MAX_AXES],
}

impl Frame {
    /// The number of words that frames of these settings have.
    #[must_use]
    pub fn length(settings: &Settings) -> usize {
        HEAD + settings.axes.count() + 2
    }

    /// Writes the words of the frame, checksum and all, and tells how many there are.
    pub fn encode(&self, settings: &Settings, words: &mut [u16; FRAME_WORDS]) -> usize {
        let body = Self::length(settings) - 2;
        words[..HEAD].copy_from_slice(&[self.epoch, self.tick, self.sequence, self.owner]);
        for (word, value) in words[HEAD..body].iter_mut().zip(&self.values) {
            *word = value.cast_unsigned();
        }
        let check = checksum(settings.machine, settings.axes, &words[..body]);
        words[body] = check.sum;
        words[body + 1] = check.of_sums;
        body + 2
    }

    /// Reads a frame; `None` when there are too few words or the checksum does not fit.
    #[must_use]
    pub fn decode(settings: &Settings, words: &[u16]) -> Option<Self> {
        let body = Self::length(settings) - 2;
        let words = words.get(..body + 2)?;
        let check = checksum(settings.machine, settings.axes, &words[..body]);
        if [check.sum, check.of_sums] != words[body..] {
            return None;
        }
        let mut values = [0; MAX_AXES];
        for (value, word) in values.iter_mut().zip(&words[HEAD..body]) {
            *value = word.cast_signed();
        }
        Some(Self {
            epoch: words[0],
            tick: words[1],
            sequence: words[2],
            owner: words[3],
            values,
        })
    }

    /// The wanted correction of each axis, counts.
    #[must_use]
    pub fn counts(&self) -> Counts {
        PerChannel::from_fn(|axis| self.values[axis])
    }
}
