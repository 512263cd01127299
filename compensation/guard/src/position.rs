//! Whether a position that a control tells can be true: within travel, and where the axis can have come to since the last one
//! that was believed.

use core::time::Duration;

use crate::turn::shortest_way;

/// Controls tell a position that is up to so much older, or younger, than the moment at which they are said to have taken it.
const UNSURE: Duration = Duration::from_millis(50);

/// Where an axis can be, and how fast it can get there, mm or rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionLimits {
    /// The lowest and the highest position; `None`: the axis turns round without an end.
    pub range: Option<[f64; 2]>,
    /// The travel after which positions may begin anew; `None`: never.
    pub turn: Option<f64>,
    /// The fastest that it moves, mm/s or rad/s.
    pub speed: f64,
}

/// Why a position cannot be true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PositionFlaw {
    /// It is outside the range of the axis.
    OutsideTravel,
    /// The axis cannot have come there since the last position that was believed.
    Jumped,
}

/// The last position of an axis that was believed. One that cannot be true is followed by none that is believed, however much
/// time passes, until one is again where the axis could have come to when the first of them was told.
#[derive(Clone, Copy, Debug, Default)]
pub struct PositionCheck {
    /// mm or rad, and when it held.
    believed: Option<(f64, Duration)>,
    /// When the first position held that was not believed since.
    refused: Option<Duration>,
}

impl PositionCheck {
    /// Judges a position (mm, rad) that held at `taken`.
    ///
    /// # Errors
    /// Why it cannot be true.
    pub fn judge(
        &mut self,
        limits: &PositionLimits,
        position: f64,
        taken: Duration,
    ) -> Result<(), PositionFlaw> {
        let outside = |[low, high]: [f64; 2]| position < low || position > high;
        let flaw = if limits.range.is_some_and(outside) {
            Some(PositionFlaw::OutsideTravel)
        } else if self.is_out_of_reach(limits, position, taken) {
            Some(PositionFlaw::Jumped)
        } else {
            None
        };
        if let Some(flaw) = flaw {
            self.refused.get_or_insert(taken);
            return Err(flaw);
        }
        (self.believed, self.refused) = (Some((position, taken)), None);
        Ok(())
    }

    /// Takes the next position as it stands.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    fn is_out_of_reach(&self, limits: &PositionLimits, position: f64, taken: Duration) -> bool {
        let Some((before, then)) = self.believed else {
            return false;
        };
        // Of two sources one may tell what is older.
        let passed = self.refused.unwrap_or(taken).abs_diff(then) + UNSURE;
        let way = shortest_way(position - before, limits.turn).abs();
        way > limits.speed * passed.as_secs_f64()
    }
}
