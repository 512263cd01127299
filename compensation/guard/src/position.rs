//! Checks of reported positions, and the direction of travel.
//!
//! A position is plausible if it is within the travel and the axis can have reached it since the last accepted
//! position.

use core::time::Duration;

use volcomp_vocabulary::{AxisKind, Direction, TURNED_AFTER, TURNED_AFTER_ROTARY};

use crate::{AxisLimits, step::shortest_way};

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

/// Travel (mm or rad) after which an axis is treated as reversed: 5 µm (rotary axes: 5e-4 deg), or two steps of its
/// reported position plus the apparent travel at standstill, whichever is larger.
///
/// `position_step` is the resolution of the reported position, mm or rad: a flickering count is not a reversal.
///
/// Apparent travel occurs if reported positions contain the correction. The correction is then subtracted as read back,
/// and `delay` is the maximum time between a change of the position and the change of the read-back. In this time the
/// correction moves by up to the slew times `delay` plus one step, and an axis at standstill seems to travel by the
/// same amount. A reversal derived from apparent travel would change the correction, which would reverse the axis again
/// and again.
#[must_use]
pub fn reversal_threshold(limits: &AxisLimits, position_step: f64, delay: Duration) -> f64 {
    let least = match limits.kind {
        AxisKind::Linear => TURNED_AFTER.0,
        AxisKind::Rotary => TURNED_AFTER_ROTARY.to_rad().0,
    };
    let lag = if limits.includes_correction {
        limits.slew_per_s * delay.as_secs_f64() + limits.resolution
    } else {
        0.0
    };
    // A NaN step is treated as 0.
    let steps = 2.0 * position_step.max(0.0);
    least.max(steps + lag)
}

/// Number of compared readings.
const READINGS: usize = 5;
/// Number of compared readings that must agree. Two wrong readings in any five have no effect, because at least one of
/// three readings that agree is correct.
const AGREE: u32 = 3;
/// Number of whole turns in one direction after which whole turns are subtracted from the positions.
const MANY_TURNS: f64 = 1000.0;
const ALL: u8 = (1 << READINGS) - 1;

/// Direction of the last motion of an axis, kept at standstill. It changes only after travel over a threshold from the last extreme, so that
/// neither noise nor a correction changes it. Three of the last five readings must show the travel, and three of five must have reached the
/// extreme: up to two wrong positions in any five have no effect. State: the last readings, the extreme, the readings beyond the threshold, and the
/// direction.
///
/// Invariants:
/// - `count` ≤ `seen` ≤ `READINGS`; only `positions[..count]` were read after the last change of direction.
/// - `extreme` is set from the fifth reading or the first command on.
/// - A set bit of `beyond` belongs to a reading since the extreme.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DirectionMemory {
    /// Time at which the last reading was valid.
    taken: Option<Duration>,
    /// The last positions, newest first, unwrapped.
    positions: [f64; READINGS],
    /// Number of stored positions.
    seen: usize,
    /// Number of stored positions that may define the extreme.
    count: usize,
    extreme: Option<f64>,
    /// Bit masks of the last readings since the extreme that exceeded the threshold, towards larger and towards smaller positions; the newest
    /// reading is the lowest bit.
    beyond: [u8; 2],
    direction: Option<Direction>,
}

impl DirectionMemory {
    /// Updates with the `position` without correction, mm or rad, of a reading valid at `taken`, and returns the
    /// direction; `None` until the axis has moved by more than the threshold. A repeated reading with the same time
    /// counts once. `turn` is the travel after which the position wraps (a rotary axis: 2π); the axis must move by less
    /// than a quarter of `turn` within four readings.
    pub fn at(
        &mut self,
        taken: Duration,
        position: f64,
        threshold: f64,
        turn: Option<f64>,
    ) -> Option<Direction> {
        // Unwrap from the last position, not from the extreme, which may be half a turn behind.
        let last = if self.seen == READINGS { Some(self.amid(None)) } else { self.extreme };
        let position = last.map_or(position, |last| unrolled(position, last, turn));
        if !position.is_finite() || self.taken.replace(taken) == Some(taken) {
            return self.direction;
        }
        self.positions.rotate_right(1);
        self.positions[0] = position;
        self.seen = (self.seen + 1).min(READINGS);
        self.count = (self.count + 1).min(READINGS);
        let Some(extreme) = self.extreme else {
            if self.seen == READINGS {
                let amid = self.amid(turn);
                let positions = self.positions.map(|at| unrolled(at, amid, turn));
                if positions.iter().all(|at| at.is_finite()) {
                    self.positions = positions;
                    self.extreme = Some(self.reached(Direction::Positive));
                }
            }
            return self.direction;
        };
        if let Some(direction) = self.direction.filter(|_| self.count >= AGREE as usize) {
            let reached = self.reached(direction);
            if (reached - extreme) * direction.sign() > 0.0 {
                (self.extreme, self.beyond) = (Some(reached), [0; 2]);
                self.rebase(turn);
                return self.direction;
            }
        }
        let way = position - extreme;
        for (seen, direction) in self.beyond.iter_mut().zip(Direction::BOTH) {
            let is_beyond = way * direction.sign() > threshold;
            *seen = (*seen << 1 | u8::from(is_beyond)) & ALL;
        }
        let agree = |(seen, direction): &(u8, Direction)| {
            seen.count_ones() >= AGREE && self.direction != Some(*direction)
        };
        let turned = self.beyond.into_iter().zip(Direction::BOTH).find(agree);
        if let Some((seen, direction)) = turned {
            // The new extreme is the reading nearest to the old extreme: the axis has reached at least this position.
            let away = |k: &usize| (self.positions[*k] - extreme).abs();
            let beyond = (0..READINGS).filter(|k| seen >> k & 1 == 1);
            let nearest = beyond.min_by(|a, b| away(a).total_cmp(&away(b)));
            (self.extreme, self.direction) = (nearest.map(|k| self.positions[k]), Some(direction));
            // Earlier readings no longer define the extreme.
            (self.count, self.beyond) = (0, [0; 2]);
        }
        self.direction
    }

    /// Forgets the direction if the last reading is more than `gap` older than `taken`: the axis may have reversed in between.
    pub fn forget_after(&mut self, gap: Duration, taken: Duration) {
        let is_old = |last: Duration| taken.saturating_sub(last) > gap;
        if self.taken.is_some_and(is_old) {
            *self = Self::default();
        }
    }

    /// The farthest position in a direction that at least `AGREE` of the last readings have reached.
    fn reached(&self, direction: Direction) -> f64 {
        let mut positions = self.positions;
        let counted = &mut positions[..self.count];
        counted.sort_unstable_by(|a, b| (b * direction.sign()).total_cmp(&(a * direction.sign())));
        counted[AGREE as usize - 1]
    }

    /// The position with the smallest sum of distances to the other positions. A median is not defined for positions
    /// that wrap.
    fn amid(&self, turn: Option<f64>) -> f64 {
        let away = |from: &f64| -> f64 {
            let ways = self.positions.iter().map(|to| shortest_way(to - from, turn));
            ways.map(f64::abs).sum()
        };
        let mut nearest = self.positions[0];
        for position in &self.positions[1..] {
            if away(position) < away(&nearest) {
                nearest = *position;
            }
        }
        nearest
    }

    /// Subtracts whole turns after many turns in one direction, because large floating-point numbers are less precise.
    fn rebase(&mut self, turn: Option<f64>) {
        let (Some(turn), Some(extreme)) = (turn, self.extreme) else {
            return;
        };
        if turn > 0.0 && extreme.abs() > MANY_TURNS * turn {
            let whole = extreme - shortest_way(extreme, Some(turn));
            self.extreme = Some(extreme - whole);
            self.positions = self.positions.map(|at| at - whole);
        }
    }

    /// Updates with a `position` and the commanded direction reported by the control. The direction applies at once,
    /// without a threshold, and earlier readings no longer count.
    pub fn commanded(&mut self, position: f64, direction: Direction) -> Option<Direction> {
        if position.is_finite() {
            *self = Self { taken: self.taken, extreme: Some(position), ..Self::default() };
        }
        self.direction = Some(direction);
        self.direction
    }
}

/// Unwraps a position that wraps after a `turn`: the equivalent position nearest to `to`.
fn unrolled(position: f64, to: f64, turn: Option<f64>) -> f64 {
    to + shortest_way(position - to, turn)
}
