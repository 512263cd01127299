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
    /// Modulo of reported positions; `None`: positions do not wrap.
    pub turn: Option<f64>,
    /// The maximum speed, mm/s or rad/s.
    pub speed: f64,
}

/// Why a position is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PositionFlaw {
    /// The position is outside the range of the axis.
    OutsideTravel,
    /// The axis cannot have reached the position since the last accepted position.
    Jumped,
}

#[derive(Clone, Copy, Debug)]
struct AcceptedPosition {
    /// Position, mm or rad.
    position: f64,
    taken: Duration,
    /// Range of the offset of the true position from the reported position, mm or rad, according to all readings
    /// accepted so far.
    offset_range: [f64; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Way {
    /// The axis has moved continuously to a position outside its range.
    Moved,
    /// The axis cannot have moved to the position according to a single reading, which may itself be wrong.
    Jumped,
    /// Later readings continue from the jump at possible speeds: the reports are assumed to be offset by the jump.
    Elsewhere,
    /// The axis jumped again before it was back: its motion since the accepted position is unknown.
    Lost,
}

#[derive(Clone, Copy, Debug)]
struct RejectedPosition {
    /// Time of the first rejection.
    since: Duration,
    /// First of the rejected positions that can follow from each other by motion, mm or rad, and its time.
    first: (f64, Duration),
    /// Last of the rejected positions that can follow from each other, mm or rad; `taken` is its time.
    position: f64,
    taken: Duration,
    way: Way,
    /// The last reading, if the axis cannot have moved to it from `position`: position, mm or rad, and time.
    stray: Option<(f64, Duration)>,
}

/// The last accepted position of an axis. After a rejection, a position is accepted only within the distance that the
/// axis could have travelled from the last accepted position until the first rejection; this distance does not grow
/// with time. Some rejections require more:
/// - If a second reading follows from a jump by motion, the next accepted position must be a jump back by the same
///   distance. Otherwise a position with a constant error could move back within the permitted distance.
/// - If the position jumps again, to a second place that two readings confirm or by a third reading that follows from
///   neither, no position is accepted until [`PositionCheck::forget`]. Otherwise an alternating error could pass for a
///   jump back.
/// - An axis that moved out of its range must move back.
///
/// Invariants:
/// - `rejected` is set only between a rejection and the next accepted position.
/// - The offset range of the accepted position is within the timestamp uncertainty and never empty.
#[derive(Clone, Copy, Debug, Default)]
pub struct PositionCheck {
    accepted: Option<AcceptedPosition>,
    rejected: Option<RejectedPosition>,
}

impl PositionCheck {
    /// Checks a position (mm, rad) valid at `taken`.
    ///
    /// # Errors
    /// Why the position is rejected.
    pub fn judge(
        &mut self,
        limits: &PositionLimits,
        position: f64,
        taken: Duration,
    ) -> Result<(), PositionFlaw> {
        let is_outside = |[low, high]: [f64; 2]| position < low || position > high;
        let is_outside = limits.range.is_some_and(is_outside);
        let offset_range = self.offset_range(limits, position, taken);
        let offset_range = offset_range.filter(|_| !self.refutes(limits, position, taken));
        if let (Some(offset_range), false) = (offset_range, is_outside) {
            self.accepted = Some(AcceptedPosition { position, taken, offset_range });
            self.rejected = None;
            return Ok(());
        }
        self.reject(limits, position, taken, offset_range.is_some());
        Err(if is_outside { PositionFlaw::OutsideTravel } else { PositionFlaw::Jumped })
    }

    /// Whether a position was reported that the axis cannot have reached, and no position was accepted since.
    #[must_use]
    pub fn has_jumped(&self) -> bool {
        let jumped = |it: RejectedPosition| it.way != Way::Moved || it.stray.is_some();
        self.rejected.is_some_and(jumped)
    }

    /// Clears the accepted position: the next position is accepted if it is within the range of the axis.
    pub fn forget(&mut self) {
        *self = Self::default();
    }

    fn reject(&mut self, limits: &PositionLimits, position: f64, taken: Duration, moved: bool) {
        let before = self.rejected;
        let leads = |from: (f64, Duration)| leads_to(limits, from, (position, taken));
        let mut first = (position, taken);
        let way = match before {
            _ if moved => Way::Moved,
            None => Way::Jumped,
            Some(RejectedPosition { way: Way::Lost, .. }) => Way::Lost,
            Some(before) if leads((before.position, before.taken)) => {
                first = before.first;
                match before.way {
                    // A repeated reading does not count as a second reading.
                    Way::Jumped if before.taken != taken => Way::Elsewhere,
                    way => way,
                }
            }
            Some(before) => match before.stray {
                Some(stray) if stray.1 != taken => {
                    first = stray;
                    if leads(stray) && before.way != Way::Elsewhere {
                        Way::Elsewhere
                    } else {
                        Way::Lost
                    }
                }
                // A single stray reading does not end the sequence of rejected positions.
                _ => {
                    self.rejected =
                        Some(RejectedPosition { stray: Some((position, taken)), ..before });
                    return;
                }
            },
        };
        self.rejected = Some(RejectedPosition {
            since: before.map_or(taken, |before| before.since),
            first,
            position,
            taken,
            way,
            stray: None,
        });
    }

    /// Whether the rejected positions contradict a position that is within reach of the accepted one: the axis is still
    /// at the offset, has jumped again, or cannot have returned yet.
    fn refutes(&self, limits: &PositionLimits, position: f64, taken: Duration) -> bool {
        self.rejected.is_some_and(|before| {
            let leads = leads_to(limits, (before.position, before.taken), (position, taken));
            match before.way {
                Way::Moved => !leads,
                Way::Jumped => false,
                Way::Elsewhere => leads || !self.is_undone(limits, &before, (position, taken)),
                Way::Lost => true,
            }
        })
    }

    /// Whether the step from the last rejected position to this position reverses the jump from the accepted position
    /// to the first rejected one, apart from the motion of the axis in between.
    fn is_undone(
        &self,
        limits: &PositionLimits,
        rejected: &RejectedPosition,
        (position, taken): (f64, Duration),
    ) -> bool {
        self.accepted.is_none_or(|accepted| {
            let (first, begun) = rejected.first;
            let sum = (first - accepted.position) + (position - rejected.position);
            let passed = begun.abs_diff(accepted.taken) + taken.abs_diff(rejected.taken);
            let allowed_s = passed.as_secs_f64() + 4.0 * TIMESTAMP_UNCERTAINTY_S;
            shortest_way(sum, limits.turn).abs() <= limits.speed * allowed_s
        })
    }

    /// Range of the offset of the true position from a reported position; `None`: the position is out of reach. The
    /// range depends on all readings since the first accepted one, so that a jump spread over many readings is
    /// detected.
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
        // With two sources, one source may report an older position.
        let until = self.rejected.map_or(taken, |rejected| rejected.since);
        let passed = until.abs_diff(before.taken);
        let goes = limits.speed * passed.as_secs_f64();
        let way = shortest_way(position - before.position, limits.turn);
        let [low, high] = before.offset_range;
        let low = (low - goes - way).max(-unsure);
        let high = (high + goes - way).min(unsure);
        (low <= high).then_some([low, high])
    }
}

/// Whether the axis can have moved from one reading (position, time) to another.
fn leads_to(limits: &PositionLimits, from: (f64, Duration), to: (f64, Duration)) -> bool {
    let way = shortest_way(to.0 - from.0, limits.turn).abs();
    let passed_s = to.1.abs_diff(from.1).as_secs_f64();
    way <= limits.speed * (passed_s + 2.0 * TIMESTAMP_UNCERTAINTY_S)
}
