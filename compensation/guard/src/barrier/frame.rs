//! The frame that a gateway sends.

use volcomp_vocabulary::{MAX_AXES, PerChannel};

use super::Settings;
use crate::protocol::{Counts, HEAD_WORDS, Head, Session, is_whole, seal};

/// The largest number of words of a frame: head, one value for each axis, checksum.
pub const FRAME_WORDS: usize = HEAD_WORDS + MAX_AXES + 2;

/// The frame of one cycle: the wanted correction and what shows that it is meant for now.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Frame {
    /// What shows that it is meant for now.
    pub head: Head,
    /// The wanted correction of each axis, counts.
    pub values: [i16; MAX_AXES],
}

impl Frame {
    /// The number of words that frames of these settings have.
    #[must_use]
    pub fn length(settings: &Settings) -> usize {
        HEAD_WORDS + settings.axes.count() + 2
    }

    /// Writes the words of the frame, checksum and all, and tells how many there are.
    pub fn encode(&self, settings: &Settings, words: &mut [u16; FRAME_WORDS]) -> usize {
        let length = Self::length(settings);
        words[..HEAD_WORDS].copy_from_slice(&self.head.words());
        for (word, value) in words[HEAD_WORDS..length - 2].iter_mut().zip(&self.values) {
            *word = value.cast_unsigned();
        }
        seal(settings.machine, settings.axes, &mut words[..length]);
        length
    }

    /// Reads a frame; `None` when there are too few words or the checksum does not fit.
    #[must_use]
    pub fn decode(settings: &Settings, words: &[u16]) -> Option<Self> {
        let length = Self::length(settings);
        let words = words.get(..length)?;
        if !is_whole(settings.machine, settings.axes, words) {
            return None;
        }
        let (head, words) = words.split_first_chunk()?;
        let mut values = [0; MAX_AXES];
        for (value, word) in values.iter_mut().zip(&words[..length - HEAD_WORDS - 2]) {
            *value = word.cast_signed();
        }
        Some(Self {
            head: Head::of(*head),
            values,
        })
    }

    /// The wanted correction of each axis, counts.
    #[must_use]
    pub fn counts(&self) -> Counts {
        PerChannel::from_fn(|axis| self.values[axis])
    }
}

impl Session {
    /// The frame of these values that answers the last report; `None` when there is no report to answer.
    pub fn frame(&mut self, values: &Counts) -> Option<Frame> {
        let head = self.answer()?;
        let values = core::array::from_fn(|axis| values[axis]);
        Some(Frame { head, values })
    }
}
