//! One axis of a control with digital lines: its words, and the tracking of its position.

use std::time::Duration;

use volcomp_vocabulary::{AxisKind, AxisName, Displacement};

use crate::words::{CorrectionWord, PositionWord};

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DigitalAxis {
    /// Letter of the axis, which also determines whether it is linear or rotary.
    pub name: AxisName,
    pub position: PositionWord,
    /// Tracking parameters if the word encodes only the low bits of the position; `None` if it encodes the whole
    /// position.
    pub low_bits: Option<LowBits>,
    pub correction: CorrectionWord,
    /// Whether reported positions contain the correction.
    pub includes_correction: bool,
}

/// Tracking of a position whose word has only the low bits. The position stays known if the axis moves less than half
/// the range of the word between two readings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LowBits {
    /// Position of the axis at the first reading, such as its reference position.
    pub from: Displacement,
    /// Maximum speed of the axis, as the travel in one second: a length for a linear axis, an angle for a rotary axis.
    pub most_per_s: Displacement,
}

impl LowBits {
    /// Maximum time between two readings of the word. After a longer time the position is unknown.
    pub(crate) fn within(&self, word: &PositionWord) -> Duration {
        let seconds = 0.5 * word.range() / self.most_per_s.mm_or_rad();
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO)
    }
}

impl DigitalAxis {
    /// Creates an axis with the published words: a position of 15 bits of 1/32 mm from 0 to 1024 mm, and a correction
    /// of 8 bits of 1 µm. These steps are lengths. For a rotary axis, set angular steps, or
    /// [`DigitalController::new`](crate::DigitalController::new) rejects the axis.
    pub fn published(name: AxisName) -> Self {
        Self {
            name,
            position: PositionWord::PUBLISHED,
            low_bits: None,
            correction: CorrectionWord::PUBLISHED,
            includes_correction: false,
        }
    }

    /// Checks that all position settings have the quantity of the axis (length or angle). The check of the description
    /// covers the correction step.
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
