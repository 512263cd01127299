//! An axis of a control that shows positions on lines: its words, and how they are followed.

use std::time::Duration;

use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::words::{CorrectionWord, PositionWord};

/// One axis and its words.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DigitalAxis {
    /// The letter of the axis, which also says whether it slides or turns.
    pub name: AxisName,
    /// The word in which the control shows the position.
    pub position: PositionWord,
    /// How the position is followed where only its low bits are shown. `None`: the word holds the whole position.
    pub low_bits: Option<LowBits>,
    /// The word in which the control takes the correction.
    pub correction: CorrectionWord,
    /// Whether shown positions contain the correction.
    pub includes_correction: bool,
}

/// How a position is followed of which only the low bits are shown. It is known as long as the axis cannot have moved by
/// half of what the word can say between two words that were read.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LowBits {
    /// The position at which the axis stands when the first word is read, such as its reference.
    pub from: Displacement,
    /// The most that the axis moves in one second.
    pub most_per_s: Displacement,
}

impl LowBits {
    /// The longest time between two words after which the position is still known.
    pub(crate) fn within(&self, word: &PositionWord) -> Duration {
        let seconds = 0.5 * word.range() / self.most_per_s.mm_or_rad();
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO)
    }
}

impl DigitalAxis {
    /// The published scheme: 15 bits of 1/32 mm from 0 to 1024 mm, 8 bits of 1 µm. Its steps are lengths: for a rotary
    /// axis, set steps that are angles, or [`DigitalController::new`](crate::DigitalController::new) refuses the axis.
    pub fn published(name: AxisName) -> Self {
        Self {
            name,
            position: PositionWord::PUBLISHED,
            low_bits: None,
            correction: CorrectionWord::PUBLISHED,
            includes_correction: false,
        }
    }

    /// Whether everything about the position is of the kind of the axis; the correction's step is checked with the
    /// description.
    pub(crate) fn check(&self) -> Result<(), String> {
        let (kind, position) = (self.name.kind(), self.position);
        let known = self.low_bits.map_or(position.zero, |low| low.from);
        if let Some(LowBits { most_per_s, .. }) = self.low_bits
            && !(most_per_s.kind() == kind && most_per_s.mm_or_rad() > 0.0)
        {
            return Err(format!(
                "axis {}: found that it moves at most {most_per_s} in a second, expected more than 0 and the unit of its positions",
                self.name
            ));
        }
        if position.is_of(kind) && known.kind() == kind {
            return Ok(());
        }
        Err(format!(
            "axis {}: found a position step of {} from {} on, expected {}",
            self.name,
            position.step,
            known,
            match kind {
                AxisKind::Linear => "lengths, since the axis is linear",
                AxisKind::Rotary => "angles, since the axis is rotary",
            }
        ))
    }
}
