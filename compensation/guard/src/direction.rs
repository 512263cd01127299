//! In which direction an axis came to where it is.

use core::time::Duration;

use volcomp_vocabulary::{AxisKind, Direction};

use crate::AxisLimits;

/// The least travel after which a linear axis counts as turned: 5 µm.
const REVERSAL_MM: f64 = 0.005;
/// The least travel after which a rotary axis counts as turned: 5e-4 deg.
const REVERSAL_RAD: f64 = 8.726_646_259_971_648e-6;

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
        AxisKind::Linear => REVERSAL_MM,
        AxisKind::Rotary => REVERSAL_RAD,
    };
    let lag = if limits.includes_correction {
        limits.slew_per_s * delay.as_secs_f64() + limits.resolution
    } else {
        0.0
    };
    // A step that is no number is none.
    let steps = 2.0 * position_step.max(0.0);
    least.max(steps + lag)
}

/// The direction of the last motion of an axis, kept while it stands: it changes only after travel over a
/// threshold from the last extreme, so that neither noise nor a correction turns it. Of three readings the middle one
/// counts, so that one wrong position turns nothing. State: the last readings, the extreme and the direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DirectionMemory {
    /// When the last reading held, and the last two positions, the older one first.
    taken: Option<Duration>,
    last: [Option<f64>; 2],
    extreme: Option<f64>,
    direction: Option<Direction>,
}

impl DirectionMemory {
    /// The axis was at `position` without correction, mm or rad, when a reading was `taken`; `None` until it went further
    /// than the threshold. What is told again with the same time is no other reading. `turn`: the position begins anew after
    /// so much travel (a rotary axis that rolls over: 2π), and between two readings the axis goes less than half of that.
    pub fn at(
        &mut self,
        taken: Duration,
        position: f64,
        threshold: f64,
        turn: Option<f64>,
    ) -> Option<Direction> {
        if !position.is_finite() || self.taken.replace(taken) == Some(taken) {
            return self.direction;
        }
        let [oldest, before] = self.last;
        self.last = [before, Some(position)];
        let Some((oldest, before)) = oldest.zip(before) else {
            return self.direction;
        };
        let ways = [oldest, position].map(|other| shortest(other - before, turn));
        let position = before + ways[0].min(ways[1]).max(ways[0].max(ways[1]).min(0.0));
        let extreme = *self.extreme.get_or_insert(position);
        let forward = shortest(position - extreme, turn);
        match self.direction {
            Some(Direction::Positive) if forward >= 0.0 => self.extreme = Some(position),
            Some(Direction::Negative) if forward <= 0.0 => self.extreme = Some(position),
            _ if forward.abs() > threshold => {
                self.direction = Direction::of(forward);
                self.extreme = Some(position);
            }
            _ => {}
        }
        self.direction
    }

    /// The axis is at `position`, and the control tells in which direction it is commanded: that counts at once,
    /// without a threshold.
    pub fn commanded(&mut self, position: f64, direction: Direction) -> Option<Direction> {
        if position.is_finite() {
            self.extreme = Some(position);
            self.last = [Some(position); 2];
        }
        self.direction = Some(direction);
        self.direction
    }
}

/// The shorter of the two ways round, where positions begin anew after a turn.
fn shortest(way: f64, turn: Option<f64>) -> f64 {
    match turn {
        Some(turn) if turn > 0.0 => way - turn * libm::round(way / turn),
        _ => way,
    }
}
