//! The correction of all axes as one vector: what belongs together is limited, ramped and moved together, and is
//! quantised last.

mod cycle;
mod follow;
mod motion;
mod wanted;

use core::time::Duration;

use volcomp_vocabulary::{AxisKind, MAX_AXES, PerChannel};

use crate::{
    Limits,
    step::{ROUNDING_STEPS, is_on_grid},
};
use cycle::Cycle;
use motion::{linear_word, rotary_word, span, within};
use wanted::reach;
pub use wanted::{Followed, Wanted};

/// Nearer than so many steps an axis is where it is to be.
const ARRIVED_STEPS: f64 = ROUNDING_STEPS;
/// A part of a ramp that is smaller than this is gone in one cycle.
const SMALLEST_PART: f64 = 1e-6;

/// What moves the vector.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Motion {
    /// Nothing yet: the next cycle that follows begins the ramp.
    #[default]
    Begins,
    /// On the ramp to what is wanted: the part that is left of it, and how much of it passes in a second.
    Ramps { left: f64, rate: f64 },
    /// Where what is wanted leads.
    Follows,
    /// On a straight line to a place, of which this part is left; before that what moved comes to rest.
    Line {
        to: PerChannel<f64>,
        left: f64,
        at_rest: bool,
    },
}

/// The correction that moves, mm for linear and rad for rotary axes: state of the guard.
///
/// The rotary axes move by one factor towards shares that rest on whole steps, as far as the linear axes can follow
/// in the same cycle; the linear shares are solved for the rotary shares as they move. So the tool tip stays where it is
/// while the tool axis turns. On a ramp the distance of the position share from what is wanted shrinks in proportion:
/// the position error of the tool shrinks from what it was at the beginning of the ramp, also when the machine moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vector {
    /// What is written.
    output: PerChannel<f64>,
    /// The correction before the quantiser, and its change in a second.
    smooth: PerChannel<f64>,
    rate: PerChannel<f64>,
    /// The part of the rate of each linear axis that follows the rotary axes.
    following: PerChannel<f64>,
    /// The slew and the acceleration that held for each axis in the last cycle, 0 before the first one.
    slew: PerChannel<f64>,
    accel: PerChannel<f64>,
    /// Where the rotary axes go to: whole steps.
    goal: PerChannel<f64>,
    /// Where the linear axes were to be in the last cycle.
    target: PerChannel<f64>,
    /// How far the position share is from what is wanted, and linear axes from a limit that was lowered: what is left of
    /// the ramp.
    offset: PerChannel<f64>,
    excess: PerChannel<f64>,
    /// The part of the offset of each linear axis that could be reached in the last cycle.
    reachable: PerChannel<f64>,
    motion: Motion,
}

impl Vector {
    /// A correction that stands at confirmed values (mm, rad). What is wanted is then reached by a ramp.
    pub fn at(applied: &PerChannel<f64>) -> Self {
        Self {
            output: *applied,
            smooth: *applied,
            goal: *applied,
            target: *applied,
            ..Self::default()
        }
    }

    /// The words that are written, mm and rad: whole steps, but where the correction stands at a value off the grid.
    pub fn output(&self) -> PerChannel<f64> {
        self.output
    }

    /// The correction before the quantiser, mm and rad.
    pub fn smooth(&self) -> PerChannel<f64> {
        self.smooth
    }

    /// Stays where it is, since nothing is written.
    pub fn stop(&mut self) {
        self.rate = PerChannel::ZERO;
        self.following = PerChannel::ZERO;
        self.target = self.smooth;
    }

    /// The ramp to what is wanted begins here: with the position share that the correction has now.
    pub fn begin_ramp(&mut self) {
        self.motion = Motion::Begins;
    }

    /// Whether the ramp to what is wanted is still to begin: in the next cycle that follows, or once what moves has come
    /// to rest.
    pub fn is_to_begin(&self) -> bool {
        self.motion == Motion::Begins
    }

    /// Whether the ramp to what is wanted is over.
    pub fn is_ramped(&self) -> bool {
        self.motion == Motion::Follows
    }

    /// A straight line to a correction (mm, rad) begins here, all axes by one factor: a ramp to zero, a shift, or the
    /// way back within a limit.
    pub fn begin_line(&mut self, to: &PerChannel<f64>) {
        self.motion = Motion::Line {
            to: *to,
            left: 1.0,
            at_rest: false,
        };
    }

    /// Whether it is on a line to this correction, or at its end.
    pub(crate) fn leads_to(&self, end: &PerChannel<f64>) -> bool {
        matches!(&self.motion, Motion::Line { to, .. } if to == end)
    }

    /// Goes on along the line for `dt_s`, whose end is brought within the limits by one factor; true once it is at its end. The line
    /// lasts as long as a ramp, or as long as the axis needs that slew and acceleration hold back most.
    pub fn advance_line(&mut self, limits: &Limits, dt_s: f64) -> bool {
        let Motion::Line { to, left, at_rest } = self.motion else {
            return true;
        };
        if dt_s <= 0.0 || !dt_s.is_finite() || !to.iter().all(|to| to.is_finite()) {
            self.stop();
            return false;
        }
        let cycle = self.cycle(limits, dt_s);
        if !at_rest && self.brakes(&cycle) {
            return false;
        }
        let within_limits = |i: usize| {
            let axis = &limits.axes[i];
            let reach = axis.reachable() + ARRIVED_STEPS * axis.resolution;
            if to[i].abs() > reach {
                reach / to[i].abs()
            } else {
                1.0
            }
        };
        let whole = cycle.places().map(within_limits).fold(1.0, f64::min);
        let mut ways = PerChannel::ZERO;
        let mut end = PerChannel::ZERO;
        for i in cycle.places() {
            let limit = limits.axes[i].reachable();
            end[i] = within([-limit, limit], whole * to[i]);
            ways[i] = end[i] - self.smooth[i];
        }
        let accel = cycle.accel_over_all(&ways);
        let ramp = if left > SMALLEST_PART {
            limits.ramp_share(dt_s) / left
        } else {
            1.0
        };
        let part = cycle.part(&ways, &self.rate, ramp, accel);
        // What would be left is too little for a cycle of its own.
        let ends = |i: usize| ((1.0 - part) * ways[i]).abs() <= ARRIVED_STEPS * cycle.step(i);
        let part = if cycle.places().all(ends) { 1.0 } else { part };
        let mut arrived = true;
        for i in cycle.places() {
            self.advance(i, part * ways[i], &cycle);
            arrived &= (end[i] - self.smooth[i]).abs() <= ARRIVED_STEPS * cycle.step(i);
        }
        if arrived {
            for i in cycle.places() {
                // But for a rounding it is there; its rate stays, since the next motion begins with it.
                self.smooth[i] = end[i];
            }
        }
        self.following = self.rate;
        self.target = self.smooth;
        self.goal = self.smooth;
        self.motion = Motion::Line {
            to,
            left: left * (1.0 - part),
            at_rest: true,
        };
        self.write(&cycle);
        if arrived {
            for i in cycle
                .places()
                .filter(|i| is_on_grid(end[*i], cycle.step(*i)))
            {
                self.output[i] = end[i];
            }
        }
        arrived
    }

    /// How long a line to zero takes that begins at rest here, with the shortest ramp that there is.
    #[must_use]
    pub fn time_to_zero(&self, limits: &Limits) -> Duration {
        let shortest = Limits {
            ramp: Duration::ZERO,
            ..*limits
        };
        // All axes go the whole way by one factor: at its rate it takes so long, and this is one over its acceleration, s².
        let (mut at_rate_s, mut eased) = (shortest.ramp_taken().as_secs_f64(), 0.0_f64);
        let axes = limits.axes.iter().zip(&self.smooth);
        for (axis, at) in axes.take(limits.count) {
            at_rate_s = at_rate_s.max(at.abs() / axis.slew_per_s);
            eased = eased.max(at.abs() / axis.accel_per_s2);
        }
        let seconds = if eased <= at_rate_s * at_rate_s {
            at_rate_s + eased / at_rate_s
        } else {
            // It brakes before it is at its rate.
            2.0 * libm::sqrt(eased)
        };
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
    }

    /// How far each axis may go in this cycle. An axis that a lowered limit left outside comes in at the old slew
    /// or the new one, whichever is lower. A lowered acceleration holds once all axes stand: what moves may need the one
    /// that it began with to stop before it is beyond what is wanted.
    fn cycle<'a>(&mut self, limits: &'a Limits, dt_s: f64) -> Cycle<'a> {
        let mut spans = PerChannel([[0.0; 2]; MAX_AXES]);
        let mut reach = reach(limits);
        let stands = self.rate.iter().all(|rate| *rate == 0.0);
        for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
            let outside = self.smooth[i].abs() > reach[i];
            let slew = if outside && self.slew[i] > 0.0 {
                axis.slew_per_s.min(self.slew[i])
            } else {
                axis.slew_per_s
            };
            let accel = if stands {
                axis.accel_per_s2
            } else {
                axis.accel_per_s2.max(self.accel[i])
            };
            self.slew[i] = slew;
            self.accel[i] = accel;
            let (at, rate) = (self.smooth[i], self.rate[i]);
            spans[i] = span(at, rate, slew, accel, axis.reachable(), dt_s);
            reach[i] = reach[i].max(at.abs());
        }
        Cycle {
            limits,
            dt_s,
            spans,
            reach,
            accel: self.accel,
        }
    }

    /// Where something else begins while the axes move: rotary axes and the linear axes that follow them come to rest by
    /// one factor, and what else moves the linear axes by another. Whether they needed this cycle for it; axes
    /// without a limit of their acceleration do not.
    fn brakes(&mut self, cycle: &Cycle) -> bool {
        let (mut moving, mut alone) = (PerChannel::ZERO, PerChannel::ZERO);
        for i in cycle.of_kind(AxisKind::Linear) {
            // Each may take half of what a linear axis is allowed.
            moving[i] = 2.0 * self.following[i];
            alone[i] = 2.0 * (self.rate[i] - self.following[i]);
        }
        for i in cycle.of_kind(AxisKind::Rotary) {
            moving[i] = self.rate[i];
        }
        let left = |rates| 1.0 - (cycle.accel_over_all(rates) * cycle.dt_s).min(1.0);
        let (moving, alone) = (left(&moving), left(&alone));
        // What needed the acceleration of before stands before the new one holds.
        let lowered = |i: usize| cycle.accel[i] > cycle.limits.axes[i].accel_per_s2;
        if moving == 0.0 && alone == 0.0 && !cycle.places().any(lowered) {
            return false;
        }
        for i in cycle.places() {
            let (rate, following) = (self.rate[i], self.following[i]);
            let rate = match cycle.limits.axes[i].kind {
                AxisKind::Linear => moving * following + alone * (rate - following),
                AxisKind::Rotary => moving * rate,
            };
            self.following[i] = moving * following;
            self.advance(i, rate * cycle.dt_s, cycle);
        }
        self.write(cycle);
        true
    }

    /// One axis goes `way`, or as far as it may.
    fn advance(&mut self, axis: usize, way: f64, cycle: &Cycle) {
        let way = within(cycle.spans[axis], way);
        self.smooth[axis] += way;
        self.rate[axis] = way / cycle.dt_s;
    }

    fn write(&mut self, cycle: &Cycle) {
        for i in cycle.places() {
            let axis = &cycle.limits.axes[i];
            let word = match axis.kind {
                AxisKind::Linear => linear_word,
                AxisKind::Rotary => rotary_word,
            };
            self.output[i] = word(self.output[i], self.smooth[i], axis);
        }
    }
}
