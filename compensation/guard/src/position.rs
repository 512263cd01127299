//! Plausibility of reported positions: within travel, and reachable since the last accepted position.

use core::time::Duration;

use crate::step::shortest_way;

/// Maximum error of a position's timestamp in either direction, s.
const TIMESTAMP_UNCERTAINTY_S: f64 = 0.025;

/// Range and speed of an axis, mm or rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionLimits {
    /// Lowest and highest position; `None`: a rotary axis without end stops.
    pub range: Option<[f64; 2]>,
    /// Modulo of reported positions; `None`: they do not wrap.
    pub turn: Option<f64>,
    /// The maximum speed, mm/s or rad/s.
    pub speed: f64,
}

/// Why a position is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PositionFlaw {
    /// The position is outside the range of the axis.
    OutsideTravel,
    /// The axis cannot have reached the position since the last accepted one.
    Jumped,
}

#[derive(Clone, Copy, Debug)]
struct AcceptedPosition {
    /// Position, mm or rad.
    position: f64,
    taken: Duration,
    /// Range of the offset of the true position from the reported one, by all readings accepted so far.
    offset_range: [f64; 2],
}

/// The last accepted position of an axis. After a rejection, only a position within the reach that
/// the axis had at the first rejection is accepted; the reach does not grow with time.
///
/// Invariants:
/// - `rejected_since` is set only between a rejection and the next accepted position.
/// - The offset range of the accepted position is within the timestamp uncertainty and never empty.
#[derive(Clone, Copy, Debug, Default)]
pub struct PositionCheck {
    accepted: Option<AcceptedPosition>,
    rejected_since: Option<Duration>,
}

impl PositionCheck {
    /// Checks a position (mm, rad) valid at `taken`.
    ///
    /// # Errors
    /// Why it is rejected.
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
                self.accepted = Some(AcceptedPosition {
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

    /// Accepts the next position unconditionally.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    /// Range of the offset of the true position from a reported one; `None`: the position is out of reach. It considers all readings since the
    /// first accepted one, so that a jump spread over many of them is detected.
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
        // With two sources, one may report an older position.
        let passed = self.rejected_since.unwrap_or(taken).abs_diff(before.taken);
        let goes = limits.speed * passed.as_secs_f64();
        let way = shortest_way(position - before.position, limits.turn);
        let [low, high] = before.offset_range;
        let low = (low - goes - way).max(-unsure);
        let high = (high + goes - way).min(unsure);
        (low <= high).then_some([low, high])
    }
}
