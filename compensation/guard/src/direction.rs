//! In which direction an axis came to where it is.

use core::time::Duration;

use volcomp_vocabulary::{AxisKind, Direction, TURNED_AFTER, TURNED_AFTER_ROTARY};

use crate::{AxisLimits, step::shortest_way};

/// The travel (mm or rad) after which an axis counts as turned: the larger of 5 µm (rotary axes: 5e-4 deg) and two steps
/// of its position plus the lag of its position at standstill.
///
/// `position_step` is the smallest step that the reported position shows, mm or rad: a count that flickers is no
/// reversal. The lag concerns positions that contain the correction: it is taken out with the value that is read back, and
/// when the position shows a change of the correction up to `delay` before or after the read-back does, an axis that stands
/// seems to travel by what the correction moves in that time. A reversal that is fed back so would turn the axis for ever.
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
    // A step that is NaN counts as 0.
    let steps = 2.0 * position_step.max(0.0);
    least.max(steps + lag)
}

/// The number of readings that are compared, and of those that must agree: so two wrong ones in any five show
/// nothing, since one of three that agree is right.
const READINGS: usize = 5;
const AGREE: u32 = 3;
/// The number of turns in one direction after which positions are counted from a place nearby again.
const MANY_TURNS: f64 = 1000.0;
/// The bits of all these readings.
const ALL: u8 = (1 << READINGS) - 1;

/// The direction of the last motion of an axis, kept while it stands: it changes only after travel over a
/// threshold from the last extreme, so that neither noise nor a correction turns it. Three of the last five readings must show
/// the travel, and the extreme is one that three of five reached: up to two wrong positions in any five turn nothing. State:
/// the last readings, the extreme, what was seen since, and the direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DirectionMemory {
    /// When the last reading held.
    taken: Option<Duration>,
    /// The last positions, the newest first, as if none began anew: how many there are, and how many count for the extreme.
    positions: [f64; READINGS],
    seen: usize,
    count: usize,
    extreme: Option<f64>,
    /// Which of the last readings since the extreme lay beyond the threshold from it, towards larger and towards smaller
    /// positions: a bit for each, the newest in the lowest one.
    beyond: [u8; 2],
    direction: Option<Direction>,
}

impl DirectionMemory {
    /// The axis was at `position` without correction, mm or rad, when a reading was `taken`; `None` until it went further
    /// than the threshold. A reading repeated with the same time counts once. `turn`: the position begins anew after
    /// so much travel (a rotary axis that rolls over: 2π), and in four readings the axis goes less than a quarter of that.
    pub fn at(
        &mut self,
        taken: Duration,
        position: f64,
        threshold: f64,
        turn: Option<f64>,
    ) -> Option<Direction> {
        // Where the axis was last, and not the extreme, which may stay half a turn behind.
        let last = if self.seen == READINGS {
            Some(self.amid(None))
        } else {
            self.extreme
        };
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
            // From the one of these readings that is nearest to where it came from: the axis is there, or further on.
            let away = |k: &usize| (self.positions[*k] - extreme).abs();
            let beyond = (0..READINGS).filter(|k| seen >> k & 1 == 1);
            let nearest = beyond.min_by(|a, b| away(a).total_cmp(&away(b)));
            (self.extreme, self.direction) = (nearest.map(|k| self.positions[k]), Some(direction));
            // What was read before does not count.
            (self.count, self.beyond) = (0, [0; 2]);
        }
        self.direction
    }

    /// The position that as many of the last readings reached in a direction as must agree.
    fn reached(&self, direction: Direction) -> f64 {
        let mut positions = self.positions;
        let counted = &mut positions[..self.count];
        counted.sort_unstable_by(|a, b| (b * direction.sign()).total_cmp(&(a * direction.sign())));
        counted[AGREE as usize - 1]
    }

    /// The position from which the others are least far away: where positions begin anew, the middle one is no other than
    /// that seen from a place among them.
    fn amid(&self, turn: Option<f64>) -> f64 {
        let away = |from: &f64| -> f64 {
            let ways = self
                .positions
                .iter()
                .map(|to| shortest_way(to - from, turn));
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

    /// Leaves out whole turns where there are many, since large numbers are coarse.
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

    /// The axis is at `position`, and the control reports in which direction it is commanded: that counts at once,
    /// without a threshold. What was read before does not count.
    pub fn commanded(&mut self, position: f64, direction: Direction) -> Option<Direction> {
        if position.is_finite() {
            *self = Self {
                taken: self.taken,
                extreme: Some(position),
                ..Self::default()
            };
        }
        self.direction = Some(direction);
        self.direction
    }
}

/// A position as if none began anew after a `turn`: that one which is nearest to another.
fn unrolled(position: f64, to: f64, turn: Option<f64>) -> f64 {
    to + shortest_way(position - to, turn)
}
