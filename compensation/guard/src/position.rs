//! Plausibility of reported positions: within travel, and within reach of the axis since the last accepted position.

use core::time::Duration;

use crate::step::shortest_way;

/// How much older or younger than its timestamp a reported position can be.
const TIMESTAMP_UNCERTAINTY_S: f64 = 0.025;

/// Range and speed of an axis, mm or rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionLimits {
    /// The lowest and the highest position; `None`: a rotary axis without ends.
    pub range: Option<[f64; 2]>,
    /// The modulo of reported positions; `None`: they do not wrap.
    pub turn: Option<f64>,
    /// The maximum speed, mm/s or rad/s.
    pub speed: f64,
}

/// Why a position cannot be true.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PositionFlaw {
    /// It is outside the range of the axis.
    OutsideTravel,
    /// The axis cannot have moved there since the last accepted position.
    Jumped,
}

#[derive(Clone, Copy, Debug)]
struct Accepted {
    /// mm or rad.
    position: f64,
    taken: Duration,
    /// Smallest and largest offset of the true position from the reported one, by all readings accepted so far.
    offset_range: [f64; 2],
}

/// The last accepted position of an axis. After a rejected one none is accepted, however much time passes, until one is within
/// the reach that the axis had when the first of them was rejected.
#[derive(Clone, Copy, Debug, Default)]
pub struct PositionCheck {
    accepted: Option<Accepted>,
    /// Timestamp of the first rejected position since.
    rejected_since: Option<Duration>,
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
            self.offset_range(limits, position, taken)
                .ok_or(PositionFlaw::Jumped)
        };
        match found {
            Ok(offset_range) => {
                self.accepted = Some(Accepted {
                    position,
                    taken,
                    offset_range,
                });
                self.rejected_since = None;
                Ok(())
            }
            Err(flaw) => {
                self.rejected_since.get_or_insert(taken);
                Err(flaw)
            }
        }
    }

    /// Accepts the next position whatever it is.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Range of the offset of the true position from a reported one; `None`: the position is out of reach. All readings since the
    /// first accepted one count, so that a jump spread over many of them is found.
    fn offset_range(
        &self,
        limits: &PositionLimits,
        position: f64,
        taken: Duration,
    ) -> Option<[f64; 2]> {
        let unsure = limits.speed * TIMESTAMP_UNCERTAINTY_S;
        let Some(before) = self.accepted else {
            return Some([-unsure, unsure]);
        };
        // Of two sources one may report the older position.
        let passed = self.rejected_since.unwrap_or(taken).abs_diff(before.taken);
        let goes = limits.speed * passed.as_secs_f64();
        let way = shortest_way(position - before.position, limits.turn);
        let [low, high] = before.offset_range;
        let low = (low - goes - way).max(-unsure);
        let high = (high + goes - way).min(unsure);
        (low <= high).then_some([low, high])
    }
}
