//! The correction of all axes as one vector: coupled components are limited, ramped and moved together, and quantised last.

use core::time::Duration;

use volcomp_vocabulary::{AxisKind, MAX_AXES, PerChannel};

use crate::{
    AxisLimits, Limits,
    step::{ROUNDING_STEPS, is_on_grid, on_grid, whole_below},
};

/// Remaining part of a ramp below which it completes in one cycle.
const SMALLEST_PART: f64 = 1e-6;

struct Share {
    /// The requested share plus the remaining offset of the ramp, mm.
    position: PerChannel<f64>,
    /// The fraction of the position share that the limits of the axes allow.
    part: f64,
    /// The present rotary shares, rad; zero for all other axes.
    rotary: PerChannel<f64>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Motion {
    /// No motion yet: the next cycle with `follow` starts the ramp.
    #[default]
    Begins,
    /// On the ramp to the requested correction: the remaining fraction, and the fraction that passes per second.
    Ramps {
        left: f64,
        rate: f64,
    },
    Follows,
    /// On a straight line to a point, with this fraction remaining. Before the line starts, any other motion comes to
    /// rest.
    Line {
        to: PerChannel<f64>,
        left: f64,
        at_rest: bool,
    },
}

/// The moving correction, mm for linear and rad for rotary axes; state of the guard.
///
/// A share is the part of the correction that one axis makes ([`RequestedCorrection`]). The rotary axes move by a
/// common factor towards shares on whole steps, as far as the linear axes can follow in the same cycle. The linear
/// shares are solved for the present rotary shares, so the tool tip stays in place while the tool axis turns. On a ramp
/// the distance between the present and the requested position share shrinks in proportion, and with it the position
/// error of the tool, even if the machine moves.
///
/// Invariants:
/// - No axis moves in a cycle by more than its slew and acceleration allow, starting from `rate`; `slew` and `accel`
///   are the limits of that cycle.
/// - `smooth` never moves further out than its previous value or the limit.
/// - On a ramp and while following, `goal` of each rotary axis is a whole step, or the value at which the motion began.
/// - `output` changes only together with a motion: [`stop`](Self::stop) keeps it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Vector {
    output: PerChannel<f64>,
    /// The correction before quantisation, mm and rad.
    smooth: PerChannel<f64>,
    /// Rate of the correction before quantisation, per second.
    rate: PerChannel<f64>,
    /// The part of the rate of each linear axis that follows the rotary axes.
    following: PerChannel<f64>,
    /// Slew and acceleration limit of each axis in the last cycle, 0 before the first cycle.
    slew: PerChannel<f64>,
    accel: PerChannel<f64>,
    /// Goal of each rotary axis, rad: a whole step.
    goal: PerChannel<f64>,
    /// Target of the linear axes in the last cycle.
    target: PerChannel<f64>,
    /// The remaining offset of the ramp: distance of the present from the requested position share (`offset`), and
    /// distance of linear axes beyond a lowered limit (`excess`).
    offset: PerChannel<f64>,
    excess: PerChannel<f64>,
    /// Fraction of the offset of each linear axis that was within reach in the last cycle.
    reachable: PerChannel<f64>,
    motion: Motion,
}

impl Vector {
    /// Creates a correction at confirmed values (mm, rad). A ramp leads from them to the requested correction.
    pub fn at(applied: &PerChannel<f64>) -> Self {
        Self {
            output: *applied,
            smooth: *applied,
            goal: *applied,
            target: *applied,
            ..Self::default()
        }
    }

    /// The written words, mm and rad: whole steps, unless the correction rests at a value off the grid.
    pub fn output(&self) -> PerChannel<f64> {
        self.output
    }

    /// The correction before quantisation, mm and rad.
    pub fn smooth(&self) -> PerChannel<f64> {
        self.smooth
    }

    /// Stops at once, because nothing is written.
    pub fn stop(&mut self) {
        self.rate = PerChannel::ZERO;
        self.following = PerChannel::ZERO;
        self.target = self.smooth;
    }

    /// Starts the ramp to the requested correction at the present correction, with the present position share.
    pub fn begin_ramp(&mut self) {
        self.motion = Motion::Begins;
    }

    /// Whether a requested ramp has not started yet. The ramp starts in the next cycle with `follow`, after any present
    /// motion has come to rest.
    pub fn is_to_begin(&self) -> bool {
        self.motion == Motion::Begins
    }

    /// Whether the ramp is complete.
    pub fn is_ramped(&self) -> bool {
        self.motion == Motion::Follows
    }

    /// Starts a straight line to a correction (mm, rad), with a common factor for all axes: a ramp
    /// to zero, a shift, or the return within a limit.
    pub fn begin_line(&mut self, to: &PerChannel<f64>) {
        self.motion = Motion::Line { to: *to, left: 1.0, at_rest: false };
    }

    pub(crate) fn leads_to(&self, end: &PerChannel<f64>) -> bool {
        matches!(&self.motion, Motion::Line { to, .. } if to == end)
    }

    /// Moves along the line for `dt_s`; the end of the line is scaled into the limits by a common factor. Returns true
    /// at the end. The line takes a ramp time, or as long as the axis that slew and acceleration limit most.
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
            if to[i].abs() > reach { reach / to[i].abs() } else { 1.0 }
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
        let ramp = if left > SMALLEST_PART { limits.ramp_share(dt_s) / left } else { 1.0 };
        let part = cycle.part(&ways, &self.rate, ramp, accel);
        // The remaining distance would be too small for another cycle.
        let ends = |i: usize| ((1.0 - part) * ways[i]).abs() <= ARRIVED_STEPS * cycle.step(i);
        let part = if cycle.places().all(ends) { 1.0 } else { part };
        let mut arrived = true;
        for i in cycle.places() {
            self.advance(i, part * ways[i], &cycle);
            arrived &= (end[i] - self.smooth[i]).abs() <= ARRIVED_STEPS * cycle.step(i);
        }
        if arrived {
            for i in cycle.places() {
                // The correction is at the end, except for rounding. The rate is kept, because the
                // next motion starts with it.
                self.smooth[i] = end[i];
            }
        }
        self.following = self.rate;
        self.target = self.smooth;
        self.goal = self.smooth;
        self.motion = Motion::Line { to, left: left * (1.0 - part), at_rest: true };
        self.write(&cycle);
        if arrived {
            for i in cycle.places().filter(|i| is_on_grid(end[*i], cycle.step(*i))) {
                self.output[i] = end[i];
            }
        }
        arrived
    }

    /// Duration of a line to zero that starts at rest at the present correction, with the shortest ramp.
    #[must_use]
    pub fn time_to_zero(&self, limits: &Limits) -> Duration {
        let shortest = Limits { ramp: Duration::ZERO, ..*limits };
        // All axes go to zero by a common factor. Accumulates the time at constant rate, and the
        // reciprocal acceleration, s².
        let (mut at_rate_s, mut eased) = (shortest.ramp_taken().as_secs_f64(), 0.0_f64);
        let axes = limits.axes.iter().zip(&self.smooth);
        for (axis, at) in axes.take(limits.count) {
            at_rate_s = at_rate_s.max(at.abs() / axis.slew_per_s);
            eased = eased.max(at.abs() / axis.accel_per_s2);
        }
        let seconds = if eased <= at_rate_s * at_rate_s {
            at_rate_s + eased / at_rate_s
        } else {
            // The axis brakes before it reaches its full rate.
            2.0 * libm::sqrt(eased)
        };
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::MAX)
    }

    /// Range of each axis in this cycle. An axis outside a lowered limit returns at the old or the new slew, whichever is lower. A lowered
    /// acceleration applies once all axes are at rest: a moving axis may need the previous one to stop before it overshoots.
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
            let accel =
                if stands { axis.accel_per_s2 } else { axis.accel_per_s2.max(self.accel[i]) };
            self.slew[i] = slew;
            self.accel[i] = accel;
            let (at, rate) = (self.smooth[i], self.rate[i]);
            spans[i] = span(at, rate, slew, accel, axis.reachable(), dt_s);
            reach[i] = reach[i].max(at.abs());
        }
        Cycle { limits, dt_s, spans, reach, accel: self.accel }
    }

    /// Brakes before another motion starts. The rotary axes and the linear axes that follow them stop with one common
    /// factor, the remaining motion of the linear axes with another factor. Returns whether this cycle was used to
    /// brake; axes without an acceleration limit stop at once and use no cycle.
    fn brakes(&mut self, cycle: &Cycle) -> bool {
        let (mut moving, mut alone) = (PerChannel::ZERO, PerChannel::ZERO);
        for i in cycle.of_kind(AxisKind::Linear) {
            // The two motions may each use half of a linear axis's acceleration.
            moving[i] = 2.0 * self.following[i];
            alone[i] = 2.0 * (self.rate[i] - self.following[i]);
        }
        for i in cycle.of_kind(AxisKind::Rotary) {
            moving[i] = self.rate[i];
        }
        let left = |rates| 1.0 - (cycle.accel_over_all(rates) * cycle.dt_s).min(1.0);
        let (moving, alone) = (left(&moving), left(&alone));
        // The new acceleration applies once the axes that need the previous one are at rest.
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

    /// Moves one axis by `way`, limited to its range in this cycle.
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

    /// Moves towards the requested correction for `dt_s`: first by a ramp, then by following the correction. Nothing
    /// moves if a number is not finite or no time has passed.
    pub fn follow(
        &mut self,
        requested: &RequestedCorrection,
        limits: &Limits,
        dt_s: f64,
    ) -> FollowResult {
        let sound = requested.is_finite();
        if !sound || dt_s <= 0.0 || !dt_s.is_finite() {
            self.stop();
            return FollowResult { slewing: !sound, behind: !sound, ..FollowResult::default() };
        }
        let cycle = self.cycle(limits, dt_s);
        let begins = matches!(self.motion, Motion::Begins | Motion::Line { .. });
        if begins && self.brakes(&cycle) {
            self.motion = Motion::Begins;
            return FollowResult { slewing: true, behind: true, ..requested.judged(1.0, limits) };
        }
        if begins {
            self.goal = self.output;
        }
        let (left, rate) = self.ramp(requested, &cycle);
        let offset = self.reach_offset(requested, &cycle);
        let share = self.share(requested, &cycle);
        // The ramp reduces an excess over a lowered limit; the range of the rotary axes does not depend on it.
        let position =
            if self.excess == PerChannel::ZERO { &share.position } else { &requested.position };
        self.goal = requested.rotary_goal(position, &self.goal, limits);

        let ways = self.rotary_ways(&cycle);
        let (ramp_accel, accel) = self.accels(requested, &ways, &cycle);
        let (ramp, braking) = if left > 0.0 {
            let ramp = (limits.ramp_share(dt_s) / left).min(1.0);
            (ramp, braking_part(rate / left, ramp_accel, dt_s))
        } else {
            (1.0, 0.0)
        };
        let eased = ramp.min(stopping_part(ramp_accel, dt_s)).max(braking);
        let turning = cycle.part(&ways, &self.rate, ramp, accel);
        let mut most = cycle.advance(&ways, turning, eased);
        let mut factor = self.factor(requested, &share, &most, &cycle);
        if factor.is_none() {
            // The motion is no faster than in the previous cycle, so that it can be braked or continue.
            let turns = cycle.going(&ways, &self.rate).max(0.0);
            let passes = if left > 0.0 { rate / left * dt_s } else { 0.0 };
            most = cycle.advance(&ways, turning.min(turns), eased.min(passes));
            factor = self.factor(requested, &share, &most, &cycle);
        }
        let mut turned = PerChannel::ZERO;
        for i in cycle.of_kind(AxisKind::Rotary) {
            let [least, most] = [most.least[i], most.most[i]];
            self.advance(i, least + factor.unwrap_or(0.0) * (most - least), &cycle);
            turned[i] = self.rate[i];
        }
        let following = requested.following(&turned);
        for i in cycle.of_kind(AxisKind::Linear) {
            // Limited to the slew of the axis: with implausible levers the motion could never be
            // braked.
            let slew = limits.axes[i].slew_per_s;
            self.following[i] = within([-slew, slew], following[i]);
        }
        // If the linear axes cannot follow at all, the ramp continues, so that it ends.
        let passed = factor.map_or(eased, |factor| factor * most.ramp);
        self.pass_ramp(left, passed, dt_s);
        let (behind, part) = self.slide(requested, &cycle);
        self.write(&cycle);
        if let Motion::Ramps { .. } = self.motion {
            self.offset = offset.map(|offset| offset * (1.0 - passed));
        }

        let waits = factor.is_none_or(|factor| factor < 1.0 - 1e-9);
        let far = cycle
            .of_kind(AxisKind::Rotary)
            .any(|i| (self.goal[i] - self.smooth[i]).abs() > 0.5 * cycle.step(i));
        FollowResult {
            slewing: behind || waits && (far || left > 0.0) || turning < ramp && far,
            behind,
            ..requested.judged(part, limits)
        }
    }

    /// Remaining fraction of the ramp, and the fraction that passes per second. Starts the ramp if it has not started.
    fn ramp(&mut self, requested: &RequestedCorrection, cycle: &Cycle) -> (f64, f64) {
        if matches!(self.motion, Motion::Begins | Motion::Line { .. }) {
            let following = requested.following(&self.rotary(cycle));
            let reach = reach(cycle.limits);
            (self.offset, self.excess) = (PerChannel::ZERO, PerChannel::ZERO);
            for i in cycle.of_kind(AxisKind::Linear) {
                self.offset[i] = self.smooth[i] - following[i] - requested.position[i];
                self.excess[i] = (self.smooth[i].abs() - reach[i]).max(0.0);
            }
            self.target = self.smooth;
            self.reachable = self.reachable.map(|_| 1.0);
            self.motion = Motion::Ramps { left: 1.0, rate: 0.0 };
        }
        match self.motion {
            Motion::Ramps { left, rate } => (left, rate),
            _ => (0.0, 0.0),
        }
    }

    /// The position share with the remaining offset of the ramp, and the fraction that the axes can carry.
    fn share(&self, requested: &RequestedCorrection, cycle: &Cycle) -> Share {
        let position = PerChannel::from_fn(|i| requested.position[i] + self.offset[i]);
        let rotary = self.rotary(cycle);
        Share { part: self.part(1.0, requested, &position, &rotary, cycle), position, rotary }
    }

    /// The fraction of a position share that the limits of the axes allow when this fraction of the ramp remains: a
    /// lowered limit takes effect with the ramp.
    fn part(
        &self,
        left: f64,
        requested: &RequestedCorrection,
        position: &PerChannel<f64>,
        rotary: &PerChannel<f64>,
        cycle: &Cycle,
    ) -> f64 {
        let mut reach = reach(cycle.limits);
        for (reach, excess) in reach.iter_mut().zip(&self.excess) {
            *reach += left * excess;
        }
        requested.position_part(position, rotary, &reach)
    }

    /// Stores the reachable offset of this cycle. Returns the offset to keep: the larger of the offsets reachable in
    /// this cycle and in the previous one, so that a single cycle with an implausible request does not end the ramp.
    fn reach_offset(&mut self, requested: &RequestedCorrection, cycle: &Cycle) -> PerChannel<f64> {
        let mut offset = self.offset;
        for i in cycle.of_kind(AxisKind::Linear) {
            let part = self.reachable_offset(i, requested, cycle);
            let stays = part.max(self.reachable[i]);
            offset[i] = stays * self.offset[i];
            self.offset[i] *= part;
            self.reachable[i] = if stays > 0.0 { part / stays } else { 1.0 };
        }
        offset
    }

    /// The fraction of the offset of a linear axis with which its position share is within the limit of the axis at
    /// some possible rotary position. The fraction is 1 unless the request exceeds the limit now, or did at the start
    /// of the ramp. The rest of the offset is dropped, and the ramp of the other axes continues. The rest can only
    /// shrink, and the error of the tool does not grow.
    fn reachable_offset(&self, axis: usize, requested: &RequestedCorrection, cycle: &Cycle) -> f64 {
        let following = cycle.of_kind(AxisKind::Rotary);
        let following: f64 =
            following.map(|r| requested.follow[r][axis].abs() * cycle.reach[r]).sum();
        let (offset, reach) = (self.offset[axis], cycle.reach[axis] + following);
        if offset == 0.0 {
            return 1.0;
        }
        ((reach.copysign(offset) - requested.position[axis]) / offset).clamp(0.0, 1.0)
    }

    fn pass_ramp(&mut self, before: f64, passed: f64, dt_s: f64) {
        let left = before * (1.0 - passed);
        if left > SMALLEST_PART {
            self.offset = self.offset.map(|offset| offset * (1.0 - passed));
            self.excess = self.excess.map(|excess| excess * (1.0 - passed));
            self.motion = Motion::Ramps { left, rate: (before - left) / dt_s };
        } else {
            (self.offset, self.excess) = (PerChannel::ZERO, PerChannel::ZERO);
            self.motion = Motion::Follows;
        }
    }

    /// The present rotary shares, zero for all other axes.
    fn rotary(&self, cycle: &Cycle) -> PerChannel<f64> {
        let mut rotary = PerChannel::ZERO;
        for i in cycle.of_kind(AxisKind::Rotary) {
            rotary[i] = self.smooth[i];
        }
        rotary
    }

    /// Distances of the rotary axes to their goals, zero for all other axes.
    fn rotary_ways(&self, cycle: &Cycle) -> PerChannel<f64> {
        let mut ways = PerChannel::ZERO;
        for i in cycle.of_kind(AxisKind::Rotary) {
            ways[i] = self.goal[i] - self.smooth[i];
        }
        ways
    }

    /// Accelerations (1/s²) for the remaining fraction of the ramp and of the rotary distances. The linear axes follow both: if there are rotary
    /// axes, each may use half of a linear axis's acceleration.
    fn accels(
        &self,
        requested: &RequestedCorrection,
        ways: &PerChannel<f64>,
        cycle: &Cycle,
    ) -> (f64, f64) {
        let rotary = cycle.accel_over(ways, AxisKind::Rotary);
        let following = cycle.accel_over(&requested.following(ways), AxisKind::Linear);
        let passing = PerChannel::from_fn(|i| self.offset[i].abs() + self.excess[i]);
        let ramp = cycle.accel_over(&passing, AxisKind::Linear);
        if cycle.of_kind(AxisKind::Rotary).next().is_some() {
            (0.5 * ramp, rotary.min(0.5 * following))
        } else {
            (ramp, rotary)
        }
    }

    /// The largest factor between the minimum and the maximum of an advance with which every linear axis can reach its
    /// position by the end of the cycle; `None` if no factor permits this.
    fn factor(
        &self,
        requested: &RequestedCorrection,
        share: &Share,
        advance: &Advance,
        cycle: &Cycle,
    ) -> Option<f64> {
        let at = |ways: &PerChannel<f64>| {
            requested.following(&PerChannel::from_fn(|i| share.rotary[i] + ways[i]))
        };
        let left = 1.0 - advance.ramp;
        let later = PerChannel::from_fn(|i| share.position[i] - advance.ramp * self.offset[i]);
        let part = self.part(left, requested, &later, &share.rotary, cycle);
        let (least, most) = (at(&advance.least), at(&advance.most));
        let (mut low, mut high) = (0.0_f64, 1.0_f64);
        for i in cycle.of_kind(AxisKind::Linear) {
            let limit = cycle.limits.axes[i].reachable().max(self.smooth[i].abs());
            let rounding = 1e-9 * cycle.step(i);
            let [lowest, highest] = cycle.spans[i].map(|way| self.smooth[i] + way);
            let base = share.part * share.position[i] + least[i];
            let passed = share.part * share.position[i] - part * later[i];
            let along = most[i] - least[i] - passed;
            // A position beyond a reachable limit is clipped to it.
            let highest =
                if highest >= limit - rounding { f64::INFINITY } else { highest + rounding };
            let lowest =
                if lowest <= -limit + rounding { f64::NEG_INFINITY } else { lowest - rounding };
            if along == 0.0 {
                if base > highest || base < lowest {
                    return None;
                }
                continue;
            }
            let ends = [(lowest - base) / along, (highest - base) / along];
            low = low.max(ends[0].min(ends[1]));
            high = high.min(ends[0].max(ends[1]));
        }
        (low <= high).then_some(high)
    }

    /// Moves the linear axes towards the positions for the present rotary shares. Returns whether an axis has not
    /// reached its position, and the fraction of the position share that the limits allow.
    fn slide(&mut self, requested: &RequestedCorrection, cycle: &Cycle) -> (bool, f64) {
        let share = self.share(requested, cycle);
        let following = requested.following(&share.rotary);
        let mut behind = false;
        for i in cycle.of_kind(AxisKind::Linear) {
            let axis = &cycle.limits.axes[i];
            let limit = axis.reachable().max(self.smooth[i].abs());
            let whole = share.part * share.position[i] + following[i];
            let target = within([-limit, limit], whole);
            // The axis moves with the target, and closes the gap at the highest rate from which it can still stop at
            // the target.
            let gap = self.target[i] - self.smooth[i];
            let back = stopping_rate(gap.abs(), cycle.accel[i], cycle.dt_s) * cycle.dt_s;
            let way = target - self.target[i] + back.min(gap.abs()).copysign(gap);
            self.advance(i, way, cycle);
            self.target[i] = target;
            behind |= (whole - self.smooth[i]).abs() > 2.0 * ARRIVED_STEPS * axis.resolution;
        }
        (behind, share.part)
    }
}

/// Number of reduced rotary shares that are tried if no neighbouring whole steps fit the limits.
const SHARES: u32 = 8;

/// The correction by a model, in channel order. A share is the displacement of one axis. For any rotary shares δ_r
/// during a motion, the matching linear shares are `position` + Σ `follow[r]`·δ_r.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RequestedCorrection {
    /// Linear shares of the position error while no rotary axis moves, mm; zero for rotary axes.
    pub position: PerChannel<f64>,
    /// The shares of the rotary axes, rad; zero for linear axes.
    pub rotary: PerChannel<f64>,
    /// For each rotary axis r and linear axis l, `follow[r][l]` is the movement of l per movement
    /// of r that keeps the tool tip in place, mm/rad. All other entries are zero.
    pub follow: PerChannel<PerChannel<f64>>,
}

/// The result of a cycle that followed the requested correction.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[allow(clippy::struct_excessive_bools, reason = "four answers that do not exclude one another")]
pub struct FollowResult {
    /// Slew or acceleration limits the correction: the ramp, rotary axes on the way to their goal, or linear axes
    /// (`behind`).
    pub slewing: bool,
    /// Whether a linear axis has not reached the position for the present rotary shares. Implies `slewing`. If false,
    /// and if the limits of the linear axes permit this position, the error of the tool exceeds neither the error
    /// without correction nor the error at the start of the ramp, apart from the rounding of the output.
    pub behind: bool,
    /// A limit allows only a part of the requested correction.
    pub limited: bool,
    /// The requested correction of an axis exceeds its warning threshold.
    pub warned: bool,
}

impl RequestedCorrection {
    /// The correction of a machine without corrected rotary axes.
    pub fn linear(position: PerChannel<f64>) -> Self {
        Self { position, ..Self::default() }
    }

    /// The whole correction without limits, mm and rad.
    pub fn full(&self) -> PerChannel<f64> {
        let following = self.following(&self.rotary);
        PerChannel::from_fn(|i| self.position[i] + following[i] + self.rotary[i])
    }

    /// Compares the request with the limits; `part` is the fraction of the position share that the limits allow.
    fn judged(&self, part: f64, limits: &Limits) -> FollowResult {
        let full = self.full();
        let over = |most: fn(&AxisLimits) -> f64| {
            let mut axes = limits.axes.iter().zip(&full).take(limits.count);
            axes.any(|(axis, full)| full.abs() > most(axis) + ROUNDING_STEPS * axis.resolution)
        };
        FollowResult {
            limited: part < 1.0 || over(|axis| axis.limit),
            warned: over(|axis| axis.warn),
            ..FollowResult::default()
        }
    }

    /// Movement of the linear axes that follows these rotary shares, mm.
    fn following(&self, rotary: &PerChannel<f64>) -> PerChannel<f64> {
        let mut following = PerChannel::ZERO;
        for (row, share) in self.follow.iter().zip(rotary) {
            if *share != 0.0 {
                for (sum, follow) in following.iter_mut().zip(row) {
                    *sum += follow * share;
                }
            }
        }
        following
    }

    pub(crate) fn is_finite(&self) -> bool {
        let finite = |values: &PerChannel<f64>| values.iter().all(|x| x.is_finite());
        finite(&self.position) && finite(&self.rotary) && self.follow.iter().all(finite)
    }

    /// Goal of the rotary axes, rad, in whole steps. It is the largest fraction of their shares with which every axis
    /// stays within its limit while the linear axes also apply `position`; zero if no fraction fits. Steps near the
    /// previous goal `before` are preferred (hysteresis).
    fn rotary_goal(
        &self,
        position: &PerChannel<f64>,
        before: &PerChannel<f64>,
        limits: &Limits,
    ) -> PerChannel<f64> {
        let reach = reach(limits);
        let following = self.following(&self.rotary);
        let along = PerChannel::from_fn(|i| following[i] + self.rotary[i]);
        let Some(part) = largest_part(position, &along, &reach) else {
            return PerChannel::ZERO;
        };
        let exact = self.rotary.map(|share| part * share);
        let rounded = rotary_of(limits, |i| {
            let axis = &limits.axes[i];
            let most = axis.reachable();
            quantised(before[i], exact[i], axis.resolution).max(-most).min(most)
        });
        if self.fits(position, &rounded, &reach) {
            return rounded;
        }
        // Rounding exceeded the limit of a linear axis. The nearest whole steps within all limits are used, going
        // towards zero.
        (0..=SHARES)
            .rev()
            .find_map(|share| {
                let part = f64::from(share) / f64::from(SHARES);
                let exact = exact.map(|whole| part * whole);
                self.nearest_steps(position, &exact, limits, &reach)
            })
            .unwrap_or_default()
    }

    /// The nearest whole steps to the rotary shares (rad) with which every axis stays within its reach.
    fn nearest_steps(
        &self,
        position: &PerChannel<f64>,
        exact: &PerChannel<f64>,
        limits: &Limits,
        reach: &PerChannel<f64>,
    ) -> Option<PerChannel<f64>> {
        // One bit per moving rotary axis: 1 for the step above its share, 0 for the step below.
        let turning = rotary_of(limits, |i| exact[i]);
        let all = (0..MAX_AXES).filter(|i| turning[*i] != 0.0).fold(0_usize, |all, i| all | 1 << i);
        let mut nearest: Option<(f64, PerChannel<f64>)> = None;
        let mut choice = 0_usize;
        loop {
            let mut away = 0.0;
            let steps = rotary_of(limits, |i| {
                let (step, share) = (limits.axes[i].resolution, exact[i]);
                let below = whole_below(share, step);
                let at = below + if choice >> i & 1 == 1 { step } else { 0.0 };
                away += (at - share).abs() / step;
                at
            });
            let is_nearer = nearest.is_none_or(|(least, _)| away < least);
            if is_nearer && self.fits(position, &steps, reach) {
                nearest = Some((away, steps));
            }
            choice = choice.wrapping_sub(all) & all;
            if choice == 0 {
                break;
            }
        }
        nearest.map(|(_, steps)| steps)
    }

    fn fits(
        &self,
        position: &PerChannel<f64>,
        rotary: &PerChannel<f64>,
        reach: &PerChannel<f64>,
    ) -> bool {
        let following = self.following(rotary);
        let all = PerChannel::from_fn(|i| position[i] + following[i] + rotary[i]);
        largest_part(&all, &PerChannel::ZERO, reach).is_some()
    }

    /// The largest fraction of a position share that keeps every linear axis within its reach with the rotary axes at
    /// `rotary`. If no fraction fits, the middle between the conflicting bounds of the axes is used, so that the output
    /// does not jump.
    fn position_part(
        &self,
        position: &PerChannel<f64>,
        rotary: &PerChannel<f64>,
        reach: &PerChannel<f64>,
    ) -> f64 {
        let following = self.following(rotary);
        let [least, most] = parts(&following, position, reach);
        let part = if least <= most || least.is_infinite() { most } else { 0.5 * (least + most) };
        part.clamp(0.0, 1.0)
    }
}

/// A value for each rotary axis, zero for all others.
fn rotary_of(limits: &Limits, mut value: impl FnMut(usize) -> f64) -> PerChannel<f64> {
    PerChannel::from_fn(|i| {
        if i < limits.count && limits.axes[i].kind == AxisKind::Rotary { value(i) } else { 0.0 }
    })
}

/// Maximum absolute value of each axis, mm and rad: its last step within the limit.
fn reach(limits: &Limits) -> PerChannel<f64> {
    let mut reach = PerChannel([f64::INFINITY; MAX_AXES]);
    for (reach, axis) in reach.iter_mut().zip(&limits.axes).take(limits.count) {
        *reach = axis.reachable() + ROUNDING_STEPS * axis.resolution;
    }
    reach
}

/// The largest fraction t in [0, 1] with which `base` + t·`along` is within the reach of every axis.
fn largest_part(
    base: &PerChannel<f64>,
    along: &PerChannel<f64>,
    reach: &PerChannel<f64>,
) -> Option<f64> {
    let [least, most] = parts(base, along, reach);
    (least <= most).then_some(most)
}

/// The smallest and the largest fraction t in [0, 1] with which `base` + t·`along` is within the reach of every axis.
/// If no fraction fits, the smallest exceeds the largest.
fn parts(base: &PerChannel<f64>, along: &PerChannel<f64>, reach: &PerChannel<f64>) -> [f64; 2] {
    let (mut least, mut most) = (0.0_f64, 1.0_f64);
    for ((base, along), reach) in base.iter().zip(along).zip(reach) {
        if along.abs() > 1e-300 {
            let (low, high) = ((-reach - base) / along, (reach - base) / along);
            least = least.max(low.min(high));
            most = most.min(low.max(high));
        } else if base.abs() > *reach {
            least = f64::INFINITY;
        }
    }
    [least, most]
}

/// An axis closer to its goal than this number of steps has arrived.
const ARRIVED_STEPS: f64 = ROUNDING_STEPS;

struct Cycle<'a> {
    limits: &'a Limits,
    dt_s: f64,
    /// Range of each axis, downwards and upwards, mm or rad.
    spans: PerChannel<[f64; 2]>,
    /// Maximum absolute value of each axis, mm or rad: its limit, or its present value if that is
    /// outside a lowered limit.
    reach: PerChannel<f64>,
    /// Acceleration of each axis, mm/s² or rad/s²: its limit, or a higher limit that was valid when the motion started.
    accel: PerChannel<f64>,
}

/// The motion that a common factor from 0 to 1 scales in a cycle.
struct Advance {
    /// Movement of each rotary axis at factor 0 (maximum braking), rad.
    least: PerChannel<f64>,
    /// Movement of each rotary axis at factor 1, rad.
    most: PerChannel<f64>,
    /// Fraction by which the remaining ramp shrinks at factor 1.
    ramp: f64,
}

impl Cycle<'_> {
    /// Indices of the used axes.
    fn places(&self) -> impl Iterator<Item = usize> + use<> {
        0..self.limits.count.min(MAX_AXES)
    }

    fn of_kind(&self, kind: AxisKind) -> impl Iterator<Item = usize> + use<'_> {
        let places = self.places();
        places.filter(move |i| self.limits.axes[*i].kind == kind)
    }

    /// The smallest step of an axis, mm or rad.
    fn step(&self, axis: usize) -> f64 {
        self.limits.axes[axis].resolution
    }

    /// Acceleration over distances that the axes of this kind cover together, 1/s². An axis at its goal, to rounding, imposes no limit.
    fn accel_over(&self, ways: &PerChannel<f64>, kind: AxisKind) -> f64 {
        self.of_kind(kind)
            .filter(|i| ways[*i].abs() > ARRIVED_STEPS * self.step(*i))
            .map(|i| self.accel[i] / ways[i].abs())
            .fold(f64::INFINITY, f64::min)
    }

    /// Acceleration over distances that all axes cover together, 1/s².
    fn accel_over_all(&self, ways: &PerChannel<f64>) -> f64 {
        self.accel_over(ways, AxisKind::Linear).min(self.accel_over(ways, AxisKind::Rotary))
    }

    /// Fraction of their remaining distances that axes with a common factor cover in this cycle. The fraction is
    /// limited by the ramp and by the need to stop at the ends. It covers at least the braking distance, and at most
    /// the range of each axis.
    fn part(&self, ways: &PerChannel<f64>, rates: &PerChannel<f64>, ramp: f64, accel: f64) -> f64 {
        let rate = self.going(ways, rates) / self.dt_s;
        let part =
            stopping_part(accel, self.dt_s).min(ramp).max(braking_part(rate, accel, self.dt_s));
        self.places().map(|i| allowed_part(self.spans[i], ways[i])).fold(part, f64::min)
    }

    /// Smallest fraction of its distance that an axis would cover at its present rate; 0 if no axis has a distance.
    fn going(&self, ways: &PerChannel<f64>, rates: &PerChannel<f64>) -> f64 {
        let part = self
            .places()
            .filter(|i| ways[*i] != 0.0)
            .map(|i| rates[i] / ways[i])
            .fold(f64::INFINITY, f64::min);
        if part.is_finite() { part * self.dt_s } else { 0.0 }
    }

    /// The permitted advance in this cycle: rotary axes cover up to `part` of their distances, and the ramp advances by
    /// up to `ramp`.
    fn advance(&self, ways: &PerChannel<f64>, part: f64, ramp: f64) -> Advance {
        let (mut least, mut most) = (PerChannel::ZERO, PerChannel::ZERO);
        for i in self.of_kind(AxisKind::Rotary) {
            least[i] = within(self.spans[i], 0.0);
            most[i] = within(self.spans[i], part * ways[i]);
        }
        Advance { least, most, ramp }
    }
}

/// Hysteresis of the quantisation, in steps: half a step plus 20 %. The output changes only if the
/// value is farther away.
const HYSTERESIS_STEPS: f64 = 0.6;

/// Largest rate from which an axis stops within `distance` at a constant deceleration, for any lengths of later cycles:
/// v²/(2a) + v·dt ≤ distance.
fn stopping_rate(distance: f64, accel: f64, dt_s: f64) -> f64 {
    if distance <= 0.0 {
        return 0.0;
    }
    // This form avoids the difference of nearly equal numbers, and the square of a possibly huge number.
    let cycles = 2.0 * distance / (accel * dt_s * dt_s);
    2.0 * distance / dt_s / (libm::sqrt(1.0 + cycles) + 1.0)
}

/// Deceleration with which an axis stops within `distance`. It exceeds the configured acceleration only if a limit or
/// an acceleration was lowered during the motion, and is then at most the previous acceleration, or the deceleration
/// that the new limit requires.
fn needed_to_stop(distance: f64, rate: f64, dt_s: f64) -> f64 {
    if rate <= 0.0 || distance <= 0.0 {
        return 0.0;
    }
    let by_rate = rate * dt_s;
    rate * rate / (libm::sqrt(distance * distance + by_rate * by_rate) + distance)
}

/// Range of an axis at position `at` with `rate` in a cycle, downwards and upwards (mm or rad): within slew and
/// acceleration, and such that the axis never passes its `limit`. Outside the limit the axis can only move inwards.
fn span(at: f64, rate: f64, slew: f64, accel: f64, limit: f64, dt_s: f64) -> [f64; 2] {
    let (up, down) = (limit - at, limit + at);
    let accel = accel.max(needed_to_stop(up, rate, dt_s)).max(needed_to_stop(down, -rate, dt_s));
    // Slew takes precedence over acceleration, and the limit over both.
    let within_slew = |rate: f64| rate.max(-slew).min(slew);
    let (least, most) = (within_slew(rate - accel * dt_s), within_slew(rate + accel * dt_s));
    let inwards = (-stopping_rate(down, accel, dt_s), stopping_rate(up, accel, dt_s));
    let lowest = least.max(inwards.0).min(inwards.1);
    let highest = most.min(inwards.1).max(inwards.0);
    [lowest * dt_s, highest * dt_s]
}

fn within([lowest, highest]: [f64; 2], value: f64) -> f64 {
    value.max(lowest).min(highest)
}

/// Fraction of `way` that the range of an axis allows.
fn allowed_part([lowest, highest]: [f64; 2], way: f64) -> f64 {
    let most = if way > 0.0 { highest } else { -lowest };
    if way == 0.0 { 1.0 } else { (most / way.abs()).clamp(0.0, 1.0) }
}

/// Fraction of the remaining distance that can be covered in a cycle with a stop at its end; `accel` is the acceleration over the total distance,
/// 1/s².
fn stopping_part(accel: f64, dt_s: f64) -> f64 {
    (stopping_rate(1.0, accel, dt_s) * dt_s).min(1.0)
}

/// Fraction of the remaining distance covered in a cycle of braking from `rate`, 1/s, with `accel`, 1/s².
fn braking_part(rate: f64, accel: f64, dt_s: f64) -> f64 {
    // An infinite acceleration stops at once.
    ((rate - accel * dt_s) * dt_s).clamp(0.0, 1.0)
}

/// The step within the hysteresis that changes the output least. Over any time, the output therefore changes by at most
/// one step more than the smooth value. An output between two steps is first rounded to the nearest step; the next step
/// is at most one step away from it.
fn quantised(output: f64, smooth: f64, step: f64) -> f64 {
    let output = on_grid(output, step);
    let away = (smooth - output) / step;
    if away.abs() <= HYSTERESIS_STEPS {
        return output;
    }
    let steps = smooth / step;
    // A rounding error must not be treated as a step.
    let steps = if away > 0.0 {
        libm::ceil(steps - HYSTERESIS_STEPS - 1e-9)
    } else {
        libm::floor(steps + HYSTERESIS_STEPS + 1e-9)
    };
    steps * step
}

fn linear_word(output: f64, smooth: f64, axis: &AxisLimits) -> f64 {
    inside(quantised(output, smooth, axis.resolution), smooth, axis)
}

/// The word of a rotary axis. It is rounded without hysteresis, because the share of the axis is on whole steps.
fn rotary_word(output: f64, smooth: f64, axis: &AxisLimits) -> f64 {
    let step = axis.resolution;
    let output = on_grid(output, step);
    let word = if (smooth - output).abs() <= (0.5 + 1e-9) * step {
        output
    } else {
        libm::round(smooth / step) * step
    };
    inside(word, smooth, axis)
}

/// Returns `word`; if it exceeds both the limit and the unrounded value `smooth`, returns `smooth` rounded towards zero
/// to a whole step.
fn inside(word: f64, smooth: f64, axis: &AxisLimits) -> f64 {
    let rounding = ROUNDING_STEPS * axis.resolution;
    if word.abs() <= axis.limit + rounding || word.abs() <= smooth.abs() + rounding {
        return word;
    }
    whole_below(smooth.abs(), axis.resolution).copysign(smooth)
}
