//! Whether a position that a control tells can be true: within travel, and where the axis can have come to since the last one
//! that was believed.

use core::time::Duration;

use crate::turn::shortest_way;

/// Controls tell a position that is up to so much older, or younger, than the moment at which they are said to have taken it.
const UNSURE_S: f64 = 0.025;

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

/// A position that was believed.
#[derive(Clone, Copy, Debug)]
struct Believed {
    /// mm or rad.
    position: f64,
    /// When it held.
    taken: Duration,
    /// Where the axis can have been then, by what was believed before, too: from here to there beside the position.
    truth: [f64; 2],
}

/// The last position of an axis that was believed. One that cannot be true is followed by none that is believed, however much
/// time passes, until one is again where the axis could have come to when the first of them was told.
#[derive(Clone, Copy, Debug, Default)]
pub struct PositionCheck {
    believed: Option<Believed>,
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
        let found = if limits.range.is_some_and(outside) {
            Err(PositionFlaw::OutsideTravel)
        } else {
            self.truth(limits, position, taken)
                .ok_or(PositionFlaw::Jumped)
        };
        match found {
            Ok(truth) => {
                self.believed = Some(Believed {
                    position,
                    taken,
                    truth,
                });
                self.refused = None;
                Ok(())
            }
            Err(flaw) => {
                self.refused.get_or_insert(taken);
                Err(flaw)
            }
        }
    }

    /// Takes the next position as it stands.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Where the axis can be when it is told to stand at a position, beside it; `None`: nowhere. All readings since the first that
    /// was believed count: a jump that is spread over many of them is one.
    fn truth(&self, limits: &PositionLimits, position: f64, taken: Duration) -> Option<[f64; 2]> {
        let unsure = limits.speed * UNSURE_S;
        let Some(before) = self.believed else {
            return Some([-unsure, unsure]);
        };
        // Of two sources one may tell what is older.
        let passed = self.refused.unwrap_or(taken).abs_diff(before.taken);
        let goes = limits.speed * passed.as_secs_f64();
        let way = shortest_way(position - before.position, limits.turn);
        let [low, high] = before.truth;
        let low = (low - goes - way).max(-unsure);
        let high = (high + goes - way).min(unsure);
        (low <= high).then_some([low, high])
    }
}
