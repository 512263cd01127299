//! Test at arming whether reported positions contain the correction as configured.

use core::{f64::consts::TAU, time::Duration};

use volcomp_vocabulary::{AxisKind, MAX_AXES, PerChannel};

use crate::{
    Limits, Reading,
    step::{ROUNDING, ROUNDING_STEPS, shortest_way},
};

/// Number of new consecutive readings at standstill before and after each shift.
const STILL_READINGS: u32 = 5;
/// Minimum time at standstill before and after each shift. It exceeds the maximum update interval
/// of most controls; if positions are updated more slowly, the number of readings determines the
/// duration.
const STILL_FOR: Duration = Duration::from_millis(250);
/// Maximum number of attempts while a position neither follows a shift nor stays.
const MOST_ATTEMPTS: u8 = 3;
/// A position that stays within this fraction of a shift has not moved. A flickering count is not a motion, since a shift is at least four counts.
/// A position that follows by a tenth of the shift therefore is also treated as staying.
const STAYED_SHARE: f64 = 0.25 + ROUNDING_STEPS;
/// Movement, as a multiple of the shift, above which the machine itself has moved the axis.
const MOVED_SHARE: f64 = 2.5;
/// The machine is treated as moving if a leg lasts `LATEST` times the required standstill, or if, after one required
/// standstill, an axis is farther away than `FAR_SHIFTS` times the shift.
const LATEST: u32 = 3;
const FAR_SHIFTS: f64 = 20.0;
/// Maximum time since the machine last moved an axis for its position to count as alive (not frozen) in the test shift.
const ALIVE_FOR: Duration = Duration::from_secs(10);

/// Result of the test shift for one axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum AxisProof {
    /// The reported position followed the shift in both directions: it contains the correction.
    Contained,
    /// The reported position did not follow either shift. It is not frozen, because the machine moved the axis
    /// recently.
    NotContained,
    /// Unknown: the axis was not shifted, its position may be frozen, or it moved otherwise.
    #[default]
    NotProven,
}

/// Result of a proof: the finding for each axis, and whether it contradicts the configuration.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Verdict {
    /// What the test shift has shown for each axis.
    pub axes: PerChannel<AxisProof>,
    /// The axes whose configuration contradicts the test. An axis also contradicts if its reported position followed
    /// both shifts by another amount, such as half or 2.5 times: the control then applies corrections in another unit.
    /// The unit cannot be tested if reported positions do not contain the correction.
    pub contradicts: PerChannel<bool>,
    /// The axes for which the test shift was conclusive.
    pub proven: PerChannel<bool>,
}

impl Verdict {
    /// `scaled`: axes whose position followed the test shift in both directions, but by another amount.
    fn of(axes: PerChannel<AxisProof>, scaled: &PerChannel<bool>, limits: &Limits) -> Self {
        Self {
            axes,
            contradicts: PerChannel::from_fn(|i| match axes[i] {
                AxisProof::Contained => !limits.axes[i].includes_correction,
                AxisProof::NotContained => limits.axes[i].includes_correction,
                AxisProof::NotProven => scaled[i],
            }),
            proven: axes.map(|axis| axis != AxisProof::NotProven),
        }
    }

    /// Whether any axis contradicts its configuration.
    #[must_use]
    pub fn is_contradiction(&self) -> bool {
        self.contradicts.iter().any(|contradicts| *contradicts)
    }
}

/// Time at which the machine, not the correction, last moved each axis. A constant position is
/// evidence only soon after such a motion. Updated in every cycle with a reading.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MotionHistory {
    /// Reported position and correction when the axis last moved.
    last: PerChannel<Option<(f64, f64)>>,
    moved: PerChannel<Option<Duration>>,
}

impl MotionHistory {
    /// Updates with a reading: positions as reported (mm, rad) and the applied correction. The machine moved an axis if its position changed by
    /// more than its test shift both with and without the correction.
    pub fn update(
        &mut self,
        now: Duration,
        positions: &PerChannel<f64>,
        applied: &PerChannel<f64>,
        limits: &Limits,
    ) {
        for i in 0..limits.count.min(MAX_AXES) {
            let (position, correction) = (positions[i], applied[i]);
            if !(position.is_finite() && correction.is_finite()) {
                continue;
            }
            let Some((before, corrected)) = self.last[i] else {
                self.last[i] = Some((position, correction));
                continue;
            };
            let reported = way(limits, i, before, position);
            let without = reported - (correction - corrected);
            let least = shift(limits, i).max(limits.axes[i].resolution);
            if reported.abs() > least && without.abs() > least {
                self.last[i] = Some((position, correction));
                self.moved[i] = Some(now);
            }
        }
    }

    /// Whether the machine moved the axis within the last 10 s.
    #[must_use]
    pub fn moved_recently(&self, now: Duration, axis: usize) -> bool {
        self.moved
            .get(axis)
            .copied()
            .flatten()
            .is_some_and(|moved| now.saturating_sub(moved) <= ALIVE_FOR)
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Leg {
    #[default]
    Begin,
    /// Shifted in the first direction: towards zero, or up.
    First,
    /// Shifted in the other direction; near the limit back to the start.
    Second,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum AxisResponse {
    FollowResult,
    Stayed,
    Between,
    /// The axis moved farther than any response to the shift: the machine moved it.
    Moved,
}

/// A span of new readings: their number, and the time of the reading before the span.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Span {
    from: Option<Duration>,
    readings: u32,
}

impl Span {
    fn goes_on(&mut self, taken: Duration) {
        match self.from {
            Some(_) => self.readings = self.readings.saturating_add(1),
            None => self.from = Some(taken),
        }
    }

    /// True if the span is at least `times` as long as the required standstill, with as many times the required
    /// readings.
    fn lasts(&self, times: u32, taken: Duration) -> bool {
        let long = |from| taken.saturating_sub(from) >= STILL_FOR * times;
        self.from.is_some_and(long) && self.readings >= STILL_READINGS * times
    }
}

/// Findings for axes, and the axes that followed the shift by another amount.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Findings {
    axes: PerChannel<AxisProof>,
    scaled: PerChannel<bool>,
}

/// State of the test shift, which shows whether reported positions contain the correction. The rotary axes are shifted
/// first, while the linear axes keep the tool tip in place; then the linear axes are shifted. Each axis is shifted one
/// way, then the other, with a standstill before and after each shift, so that creep or a slow position cannot look
/// like a response. If the machine starts to move, the correction returns to the start, and the test restarts at the
/// next standstill: a remaining shift would be an error of the part.
///
/// Invariants:
/// - `before_leg[0]` is valid from the first leg on, `before_leg[1]` from the second.
/// - `rotary` is `Some` once the rotary axes have been tested; from then on the linear axes are shifted.
/// - A reading counts only if it was valid after the correction had reached the goal of the leg (`arrived_at`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Proof {
    /// Time at which the last reading was valid.
    taken: Option<Duration>,
    /// Positions at the start of the standstill, mm or rad.
    positions: PerChannel<f64>,
    /// Duration of the standstill.
    still: Span,
    /// Readings since the correction has been at the goal of the leg; `arrived_at` is the time at which it was first
    /// found there.
    reached: Span,
    arrived_at: Option<Duration>,
    leg: Leg,
    /// The axes that the machine had moved within 10 s before the first shift.
    alive: PerChannel<bool>,
    /// Positions before the leg and after the first leg, mm or rad.
    before_leg: [PerChannel<f64>; 2],
    attempts: u8,
    /// How the linear axes follow each rotary axis, mm/rad.
    follow: PerChannel<PerChannel<f64>>,
    /// Findings for the rotary axes; `None`: not shifted yet.
    rotary: Option<Findings>,
}

impl Proof {
    /// Correction of each axis (mm or rad) to apply in the present leg of the test. `from` is the correction at the
    /// start of the test.
    #[must_use]
    pub fn goal(&self, from: &PerChannel<f64>, limits: &Limits) -> PerChannel<f64> {
        self.at(self.leg, from, limits)
    }

    /// Sets the movement of the linear axes per movement of each rotary axis that keeps the tool tip in place, mm/rad
    /// ([`RequestedCorrection::follow`](crate::RequestedCorrection)). Ignored from the first shift of an attempt to its
    /// end.
    pub fn set_follow(&mut self, follow: &PerChannel<PerChannel<f64>>) {
        if self.leg == Leg::Begin {
            self.follow = *follow;
        }
    }

    /// Processes a reading at `now`. `output` is the applied correction, `from` the correction at the start of the test
    /// (mm, rad). Returns the verdict once the test is complete. Repeated readings, and readings valid before the
    /// present shift was complete, are ignored.
    pub fn read(
        &mut self,
        now: Duration,
        reading: &Reading,
        output: &PerChannel<f64>,
        from: &PerChannel<f64>,
        limits: &Limits,
        moves: &MotionHistory,
    ) -> Option<Verdict> {
        let Reading { taken, positions } = reading;
        let count = limits.count.min(MAX_AXES);
        let goal = self.goal(from, limits);
        let step = |i: usize| limits.axes[i].resolution;
        let has_arrived = (0..count).all(|i| (output[i] - goal[i]).abs() < step(i));
        if !has_arrived {
            self.restart_wait();
            return None;
        }
        let arrived_at = *self.arrived_at.get_or_insert(now);
        if self.taken.replace(*taken) == Some(*taken) || *taken < arrived_at {
            return None;
        }
        let taken = now.min(*taken);
        self.reached.goes_on(taken);
        let is_still = self.still.from.is_some()
            && (0..count).all(|i| {
                let away = way(limits, i, self.positions[i], positions[i]).abs();
                away <= STAYED_SHARE * shift(limits, i).max(step(i))
            });
        if !is_still {
            (self.positions, self.still) = (*positions, Span::default());
        }
        self.still.goes_on(taken);
        if !is_still && self.goes_on(taken, positions, limits) {
            self.restart(self.attempts, positions);
            return None;
        }
        if !self.still.lasts(1, taken) {
            return None;
        }
        self.restart_wait();
        match self.leg {
            Leg::Begin => {
                let moved_recently =
                    PerChannel::from_fn(|i| self.alive[i] || moves.moved_recently(now, i));
                (self.before_leg[0], self.alive) = (*positions, moved_recently);
                self.leg = Leg::First;
                None
            }
            Leg::First => {
                self.before_leg[1] = *positions;
                self.leg = Leg::Second;
                None
            }
            Leg::Second => self.judge(positions, from, limits),
        }
    }

    /// Restarts the wait because the correction is in motion.
    fn restart_wait(&mut self) {
        self.arrived_at = None;
        (self.still, self.reached) = (Span::default(), Span::default());
    }

    /// Completes an attempt: returns the verdict, tries again, or continues with the linear axes after the rotary axes.
    fn judge(
        &mut self,
        positions: &PerChannel<f64>,
        from: &PerChannel<f64>,
        limits: &Limits,
    ) -> Option<Verdict> {
        let [begin, first, second] =
            [Leg::Begin, Leg::First, Leg::Second].map(|leg| self.at(leg, from, limits));
        let [before, between] = self.before_leg;
        let kind = self.kind(limits);
        let mut shown = self.rotary.unwrap_or_default();
        let (mut unclear, mut moved) = (false, false);
        // An axis that could not be shifted has no finding.
        let is_shifted = |i: &usize| first[*i] != begin[*i] && second[*i] != first[*i];
        for i in of_kind(kind, limits).filter(is_shifted) {
            let shares = [
                way(limits, i, before[i], between[i]) / (first[i] - begin[i]),
                way(limits, i, between[i], positions[i]) / (second[i] - first[i]),
            ];
            shown.axes[i] = match shares.map(response_of) {
                [AxisResponse::FollowResult, AxisResponse::FollowResult] => AxisProof::Contained,
                [AxisResponse::Stayed, AxisResponse::Stayed] if self.alive[i] => {
                    AxisProof::NotContained
                }
                [AxisResponse::Stayed, AxisResponse::Stayed] => AxisProof::NotProven,
                _ if is_one_factor(shares) => {
                    shown.scaled[i] = true;
                    AxisProof::NotProven
                }
                both => {
                    moved |= both.contains(&AxisResponse::Moved);
                    unclear = true;
                    AxisProof::NotProven
                }
            };
        }
        let attempts = if moved { self.attempts } else { self.attempts + 1 };
        let is_scaled = shown.scaled.iter().any(|scaled| *scaled);
        if unclear && !is_scaled && attempts < MOST_ATTEMPTS {
            self.restart(attempts, positions);
            return None;
        }
        let verdict = Verdict::of(shown.axes, &shown.scaled, limits);
        let goes_on = kind == AxisKind::Rotary && of_kind(AxisKind::Linear, limits).count() > 0;
        if goes_on && !verdict.is_contradiction() {
            self.rotary = Some(shown);
            let alive = self.alive;
            self.restart(0, positions);
            self.alive = alive;
            return None;
        }
        Some(verdict)
    }

    fn kind(&self, limits: &Limits) -> AxisKind {
        if self.rotary.is_none() && of_kind(AxisKind::Rotary, limits).count() > 0 {
            AxisKind::Rotary
        } else {
            AxisKind::Linear
        }
    }

    /// The correction of a leg. Each axis is shifted from its start in both directions, first towards zero; near its limit it is shifted
    /// inwards and back only. The linear axes follow the rotary axes; if their limits do not permit this, nothing is shifted.
    fn at(&self, leg: Leg, from: &PerChannel<f64>, limits: &Limits) -> PerChannel<f64> {
        let begin = self.begin(from, limits);
        let kind = self.kind(limits);
        let mut goal = begin;
        for i in of_kind(kind, limits) {
            goal[i] = at_leg(leg, i, begin[i], limits);
        }
        if kind == AxisKind::Linear {
            return goal;
        }
        let shifts = PerChannel::from_fn(|i| goal[i] - begin[i]);
        for i in (0..limits.count.min(MAX_AXES)).filter(|i| limits.axes[*i].kind != kind) {
            let axis = &limits.axes[i];
            let set_follow: f64 = limits.places().map(|r| self.follow[r][i] * shifts[r]).sum();
            goal[i] += libm::round(set_follow / axis.resolution) * axis.resolution;
            if set_follow != 0.0 && goal[i].abs() > axis.reachable() * ROUNDING {
                return begin;
            }
        }
        goal
    }

    /// The correction before the shift: the correction at the start of the proof. If a limit was lowered, this
    /// correction is reduced by a common factor, with the rotary axes on whole steps and the linear axes following.
    fn begin(&self, from: &PerChannel<f64>, limits: &Limits) -> PerChannel<f64> {
        let axes = || limits.axes.iter().enumerate().take(limits.count);
        let part = axes()
            .map(|(i, axis)| axis.reachable() * (1.0 + 1e-9) / from[i].abs())
            .fold(1.0, f64::min);
        let mut begin = *from;
        if part >= 1.0 {
            return begin;
        }
        let mut set_follow = PerChannel::ZERO;
        for (r, axis) in axes().filter(|(_, axis)| axis.kind == AxisKind::Rotary) {
            begin[r] = libm::trunc(part * from[r] / axis.resolution) * axis.resolution;
            for (l, set_follow) in set_follow.iter_mut().enumerate() {
                *set_follow += self.follow[r][l] * (begin[r] - part * from[r]);
            }
        }
        for (l, axis) in axes().filter(|(_, axis)| axis.kind == AxisKind::Linear) {
            let (exact, most) = (part * from[l] + set_follow[l], axis.reachable());
            let step = axis.resolution;
            begin[l] = (libm::round(exact / step) * step).clamp(-most, most);
        }
        begin
    }

    /// Whether the machine itself moves an axis: the motion lasts longer or goes farther than any response to a shift.
    fn goes_on(&self, taken: Duration, positions: &PerChannel<f64>, limits: &Limits) -> bool {
        let before = match self.leg {
            // Before the first leg, nothing is shifted.
            Leg::Begin => return false,
            Leg::First => &self.before_leg[0],
            Leg::Second => &self.before_leg[1],
        };
        let went_far = |i: usize| {
            let most = FAR_SHIFTS * shift(limits, i).max(limits.axes[i].resolution);
            way(limits, i, before[i], positions[i]).abs() > most
        };
        let is_far = (0..limits.count.min(MAX_AXES)).any(went_far);
        self.reached.lasts(LATEST, taken) || self.reached.lasts(1, taken) && is_far
    }

    fn restart(&mut self, attempts: u8, positions: &PerChannel<f64>) {
        *self = Self {
            attempts,
            taken: self.taken,
            positions: *positions,
            rotary: self.rotary,
            follow: self.follow,
            ..Self::default()
        };
    }
}

/// Distance of an axis between two reported positions, mm or rad; a rotary axis may have wrapped in between.
fn way(limits: &Limits, axis: usize, from: f64, to: f64) -> f64 {
    let rolls_over = limits.axes[axis].kind == AxisKind::Rotary;
    shortest_way(to - from, rolls_over.then_some(TAU))
}

/// Whether a position followed both shifts by the same fraction of the shift; a motion of the machine would not.
fn is_one_factor([one, two]: [f64; 2]) -> bool {
    (one - two).abs() <= STAYED_SHARE * one.abs().max(two.abs())
}

/// Response of a position that moved by this fraction of the shift.
fn response_of(share: f64) -> AxisResponse {
    if share.abs() <= STAYED_SHARE {
        AxisResponse::Stayed
    } else if (share - 1.0).abs() <= STAYED_SHARE {
        AxisResponse::FollowResult
    } else if share.abs() > MOVED_SHARE {
        AxisResponse::Moved
    } else {
        AxisResponse::Between
    }
}

/// The shift of an axis in whole steps; 0 if its limit does not permit a shift.
fn shift(limits: &Limits, axis: usize) -> f64 {
    let of_axis = &limits.axes[axis];
    let step = of_axis.resolution;
    (libm::round(limits.test_shift[axis] / step) * step).min(of_axis.reachable())
}

fn of_kind(kind: AxisKind, limits: &Limits) -> impl Iterator<Item = usize> {
    let axes = 0..limits.count.min(MAX_AXES);
    axes.filter(move |&i| limits.axes[i].kind == kind && shift(limits, i) > 0.0)
}

fn at_leg(leg: Leg, axis: usize, begin: f64, limits: &Limits) -> f64 {
    let most = limits.axes[axis].reachable();
    let inwards = if begin > 0.0 { -1.0 } else { 1.0 } * shift(limits, axis);
    match leg {
        Leg::First => begin + inwards,
        Leg::Second if (begin - inwards).abs() <= most * ROUNDING => begin - inwards,
        Leg::Begin | Leg::Second => begin,
    }
}
