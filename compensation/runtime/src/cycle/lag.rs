//! Reduces a correction by the age of the positions: the older they are, the farther the machine may have moved.
//!
//! State: the speeds of the axes, and past corrections.

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use volcomp_guard::AxisLimits;
    use volcomp_model::{Fading, Machine};
    use volcomp_vocabulary::PerChannel;

    use super::*;

    /// The reduced correction is never worse than no correction, for any distance by which the required
    /// correction changes.
    #[test]
    fn a_reduced_correction_is_never_worse_than_none() {
        let of = |x: f64, y: f64| PerAxis::from_fn(|i| [x, y].get(i).copied().unwrap_or(0.0));
        for distance in [0.0, 0.3, 0.5, 0.6, 0.8, 0.99, 1.0, 1.5] {
            for degree in 0..360 {
                let (sin, cos) = f64::from(degree).to_radians().sin_cos();
                let (does, needed) = (of(1.0, 0.0), of(1.0 + distance * cos, distance * sin));
                let part = Comparison::new(&does, &needed, 0.0).part();
                let left = (needed[0] - part).hypot(needed[1]);
                let without = needed[0].hypot(needed[1]);
                assert!(left <= without + 1e-12, "{distance} {degree}: {part}");
                assert_eq!(part > 1.0 - 1e-9, distance <= 0.5, "{distance} {degree}: {part}");
            }
        }
        let part = |needed, step| Comparison::new(&of(0.0, 0.0), &of(needed, 0.0), step).part();
        assert_eq!(part(0.0, 0.0), 1.0);
        assert_eq!(part(0.5, 1.0), 1.0, "within a step");
        assert_eq!(part(2.0, 1.0), 0.0);
    }

    /// A machine with a rotary table and a head, and random polynomials, waves and tables as errors.
    fn random_model(random: &mut ChaCha8Rng) -> Model {
        let mut number = |size: f64| random.random_range(-size..=size);
        let mut lines =
            vec!["structure = \"w C' X' b Y Z B t\"\n[tool]\ntip = [0.0, 0.0, -120.0]".to_owned()];
        for (axis, half) in [("X", 400), ("Y", 400), ("Z", 400), ("B", 110), ("C", 180)] {
            let point = [number(200.0), number(200.0), number(200.0)];
            lines.push(format!("[axes.{axis}]\ntravel = [-{half}, {half}]\npoint = {point:?}"));
        }
        lines.push("[errors]".to_owned());
        for (axis, half) in [("X", 400), ("Y", 400), ("Z", 400), ("B", 110), ("C", 180)] {
            let half: i32 = half;
            for error in ["EX", "EY", "EZ", "EA", "EB", "EC"] {
                let size = 10.0 * number(1.0).abs();
                let of = [number(size), number(size), number(size)];
                let kind = number(1.5);
                lines.push(if kind > 0.5 {
                    let nodes =
                        (-(half / 20)..=half / 20).map(|n| [f64::from(20 * n), number(size)]);
                    let table: Vec<_> = nodes.collect();
                    format!("{error}{axis} = {{ table = {table:?} }}")
                } else if kind > -0.5 {
                    let period = 10.0_f64.powf(1.0 + number(1.0).abs());
                    format!("{error}{axis} = {{ fourier = {of:?}, period = {period:?} }}")
                } else {
                    format!("{error}{axis} = {{ chebyshev = {of:?}, domain = [-{half}, {half}] }}")
                });
            }
        }
        let machine = Machine::parse(&lines.join("\n"), "m").expect("valid");
        Model::new(&machine, Fading::default()).expect("compiles")
    }

    /// Counts of skipped, made and reducing predictions, and
    /// the smallest factor to which a skipped prediction would have reduced the correction.
    #[derive(Debug)]
    struct Looks {
        spared: u32,
        taken: u32,
        reduced: u32,
        least: f64,
    }

    /// Predicts, or skips the prediction, with the axes at this position and time; counts the outcome.
    fn look(
        lag: &mut Lag,
        looks: &mut Looks,
        model: &Model,
        q: PerAxis<f64>,
        now: Duration,
        ahead: Duration,
    ) {
        let axes = std::array::from_fn(|i| {
            let axis = AxisLimits::NONE;
            model.axes.get(i).map_or(axis, |name| AxisLimits {
                kind: name.kind(),
                resolution: if name.is_rotary() { 1e-6 } else { 1e-4 },
                ..axis
            })
        });
        let limits = Limits {
            axes,
            count: model.axes.len(),
            period: Duration::from_millis(4),
            hold: Duration::from_millis(50),
            zero_after: Duration::from_millis(500),
            ramp: Duration::from_millis(500),
            test_shift: PerChannel::ZERO,
            read_back_cycles: 1,
            only_thermal: false,
        };
        let place =
            MachinePosition { positions: q, oldest: Some(now), ..MachinePosition::default() };
        lag.update(&place, model);
        let state = State { q, ..State::default() };
        let correctors = model.correctors_among(&model.axes);
        let wanted = model.wanted(&state, &correctors, &PerAxis::ZERO);
        let inputs = PredictionInputs {
            model,
            correctors: &correctors,
            only_thermal: false,
            limits: &limits,
            way_out: Duration::ZERO,
            state: &state,
            wanted: &wanted,
            applied: &PerAxis::ZERO,
        };
        let part = inputs.part_ahead(&lag.speed, ahead);
        looks.reduced += u32::from(part < 1.0);
        if lag.is_calm(&inputs, now, ahead) {
            looks.spared += 1;
            looks.least = looks.least.min(part);
        } else {
            looks.taken += 1;
        }
        lag.remember(&wanted, now);
    }

    const NO_LOOKS: Looks = Looks { spared: 0, taken: 0, reduced: 0, least: 1.0 };

    #[test]
    fn a_skipped_prediction_would_reduce_nothing() {
        let mut random = ChaCha8Rng::seed_from_u64(6);
        let mut looks = NO_LOOKS;
        for _ in 0..60 {
            let model = random_model(&mut random);
            for _ in 0..20 {
                let period_s = 10.0_f64.powf(random.random_range(-3.0..-1.8));
                let feed = 10.0_f64.powf(random.random_range(0.0..2.9));
                let ahead = Duration::from_secs_f64(period_s * random.random_range(1.0..8.0));
                let [mut q, mut speed, mut goal] = [PerAxis::ZERO; 3];
                for (q, name) in q.iter_mut().zip(&model.axes) {
                    let most = if name.is_rotary() { 1.5 } else { 300.0 };
                    *q = random.random_range(-most..most);
                }
                let mut lag = Lag::default();
                for cycle in 0..150_u32 {
                    for (axis, name) in model.axes.iter().enumerate() {
                        let scale = if name.is_rotary() { 0.005 } else { 1.0 };
                        if cycle % 40 == 0 {
                            let moves = random.random_bool(0.6);
                            let part = random.random_range(-1.0..1.0);
                            goal[axis] = if moves { part * feed * scale } else { 0.0 };
                        }
                        // Acceleration of 5 m/s², scaled for rotary axes.
                        let most = 5000.0 * period_s * scale;
                        speed[axis] += (goal[axis] - speed[axis]).clamp(-most, most);
                        q[axis] += speed[axis] * period_s;
                    }
                    let now = Duration::from_secs_f64(1.0 + f64::from(cycle) * period_s);
                    look(&mut lag, &mut looks, &model, q, now, ahead);
                }
            }
        }
        println!("{looks:?}");
        assert!(looks.least >= 1.0, "{looks:?}");
        assert!(looks.spared > 50_000 && looks.reduced > 5_000, "{looks:?}");
    }

    /// The curve is flat up to a node and steep after it.
    #[test]
    fn no_prediction_is_skipped_before_a_bend() {
        let text = "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 400]\nY.travel = [0, 400]\nZ.travel = [0, 400]\n[errors]\nEXX = { table = [[0.0, 10.0], [200.0, 10.0], [204.0, -10.0], [400.0, -10.0]] }\n";
        let machine = Machine::parse(text, "m").expect("valid");
        let model = Model::new(&machine, Fading::default()).expect("compiles");
        let (mut lag, mut looks) = (Lag::default(), NO_LOOKS);
        for ms in 0..1000_u32 {
            let at = f64::from(ms) * 0.3;
            let q = PerAxis::from_fn(|axis| if axis == 0 { at } else { 100.0 });
            let now = Duration::from_millis(u64::from(ms));
            look(&mut lag, &mut looks, &model, q, now, Duration::from_millis(12));
        }
        println!("{looks:?}");
        assert!(looks.least >= 1.0 && looks.reduced > 5, "{looks:?}");
        assert!(looks.spared > 900, "{looks:?}");
    }
}

use std::time::Duration;

use volcomp_guard::{Limits, Reasons, shortest_way};
use volcomp_kinematics::{Correctors, State};
use volcomp_vocabulary::{AxisKind, PerAxis};

use crate::{
    model::{CoupledCorrection, Model},
    path::MachinePosition,
};

/// Minimum time over which speeds are measured; over a shorter time the resolution of the positions dominates.
const BASE: Duration = Duration::from_millis(20);
/// Time for which a reduction stays reported, because at speed it changes with every position.
const REPORTED_FOR: Duration = Duration::from_secs(2);
const MAX_AHEAD: Duration = Duration::from_secs(10);

/// Interval at which past corrections are stored.
const SPACING: Duration = Duration::from_millis(10);
/// Number of past corrections that are stored.
const REMEMBERED: usize = 3;
/// No prediction is made if the requested correction has changed by at most this fraction over a time as long as the
/// prediction time `ahead`. If the stored corrections cover a longer time, the threshold grows in proportion, up to
/// `MOST_CHANGE`. For a parabolic change, the change ahead is then at most eleven times as large, which is less than
/// half of the correction.
const CALM_CHANGE: f64 = 1.0 / 32.0;
const MOST_CHANGE: f64 = 1.0 / 8.0;

/// Speeds of the axes, and past corrections.
///
/// Invariants:
/// - `wanted` is in descending order of time, entries at least `SPACING` apart, and all from the active model.
/// - `goes_out` is set only while positions are stale.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lag {
    /// Positions from which the speed was last measured, and the time at which they were valid.
    before: Option<(PerAxis<f64>, Duration)>,
    /// Past corrections requested by the model, and the times of their positions; newest first.
    wanted: [Option<(CoupledCorrection, Duration)>; REMEMBERED],
    /// Speed of each axis, mm/s and rad/s.
    speed: PerAxis<f64>,
    last: Option<Duration>,
    /// Whether the correction ramps out fast until positions are fresh again.
    goes_out: bool,
}

pub(super) struct PredictionInputs<'a> {
    pub(super) model: &'a Model,
    pub(super) correctors: &'a Correctors,
    pub(super) only_thermal: bool,
    pub(super) limits: &'a Limits,
    pub(super) state: &'a State,
    pub(super) wanted: &'a CoupledCorrection,
    /// Applied correction in machine order, mm and rad.
    pub(super) applied: &'a PerAxis<f64>,
    pub(super) way_out: Duration,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reduction {
    /// Largest factor on the correction, 0 to 1, with which the error is smaller than without
    /// correction.
    pub(super) part: f64,
    /// Whether positions are stale, and the held correction would become worse than no correction.
    pub(super) fast_ramp_out: bool,
    pub(super) notes: Reasons,
}

impl Lag {
    pub(super) fn update(&mut self, place: &MachinePosition, model: &Model) {
        let Some(taken) = place.oldest else { return };
        let Some((before, at)) = self.before else {
            self.before = Some((place.positions, taken));
            return;
        };
        let passed = taken.saturating_sub(at);
        if passed < BASE {
            return;
        }
        self.speed = PerAxis::from_fn(|axis| {
            let way = place.positions[axis] - before[axis];
            shortest_way(way, model.turn_of(axis)) / passed.as_secs_f64()
        });
        self.before = Some((place.positions, taken));
    }

    /// Computes the largest factor with which a correction c reduces the error if positions have this `age`.
    /// Until the correction reaches the axes, the machine continues at its speed, and the required
    /// correction changes by some distance d. If d ≤ c/2, the whole correction is better than none,
    /// in whatever direction it changes. For larger d the factor is 2·(1 − d/c), which is 0 at d =
    /// c.
    pub(super) fn reduction(
        &mut self,
        inputs: &PredictionInputs<'_>,
        age: Duration,
        now: Duration,
    ) -> Reduction {
        let limits = inputs.limits;
        let stale = age > limits.hold;
        let mut ahead = age.saturating_add(limits.delay());
        if stale {
            // A held correction ramps out at its slew, which takes additional time.
            ahead = ahead.saturating_add(inputs.way_out);
        }
        let ahead = ahead.min(MAX_AHEAD);
        let taken = now.saturating_sub(age);
        let moves = self.speed.iter().any(|speed| *speed != 0.0);
        let part = if moves && !self.is_calm(inputs, taken, ahead) {
            inputs.part_ahead(&self.speed, ahead)
        } else {
            1.0
        };
        self.remember(inputs.wanted, taken);
        self.goes_out = stale && (self.goes_out || part < 1.0);
        if part < 1.0 {
            self.last = Some(now);
        }
        let is_reported = self.last.is_some_and(|last| now.saturating_sub(last) <= REPORTED_FOR);
        Reduction {
            part,
            fast_ramp_out: self.goes_out,
            notes: Reasons::REDUCED_BY_AGE.when(is_reported),
        }
    }
}

impl Lag {
    /// Whether the correction changed so little before the time `taken` of the positions that a prediction
    /// would not reduce it. A prediction costs as much as the rest of the cycle.
    fn is_calm(&self, inputs: &PredictionInputs<'_>, taken: Duration, ahead: Duration) -> bool {
        let Some((_, begun)) = self.wanted[REMEMBERED - 1] else {
            return false;
        };
        let stretch = taken.saturating_sub(begun);
        // Near a singular pose corrections start and end abruptly, and a curve may bend at a node, so the past does not predict the change.
        let may_bend = |(axis, (at, speed)): (usize, (&f64, &f64))| {
            let [from, to] = [-stretch.as_secs_f64(), ahead.as_secs_f64()].map(|s| at + speed * s);
            from != to && inputs.model.may_bend_between(axis, from, to)
        };
        let mut axes = inputs.state.q.iter().zip(&self.speed).enumerate();
        let wanted = inputs.wanted;
        if ahead > stretch
            || stretch.is_zero()
            || wanted.near_singular
            || wanted.linear_near_singular
            || axes.any(may_bend)
        {
            return false;
        }
        let part = ahead.as_secs_f64() / stretch.as_secs_f64();
        let most = (CALM_CHANGE / part).min(MOST_CHANGE);
        let mut past = self.wanted.iter().flatten();
        past.all(|(then, _)| inputs.compare(then).iter().all(|compare| compare.is_within(most)))
    }

    fn remember(&mut self, wanted: &CoupledCorrection, taken: Duration) {
        let is_due = |(_, last): (_, Duration)| taken.saturating_sub(last) >= SPACING;
        if self.wanted[0].is_none_or(is_due) {
            self.wanted.rotate_right(1);
            self.wanted[0] = Some((*wanted, taken));
        }
    }

    /// Discards the past corrections, which belong to the replaced model.
    pub(super) fn forget(&mut self) {
        self.wanted = [None; REMEMBERED];
    }
}

impl PredictionInputs<'_> {
    /// The smaller of two factors with which the correction is better than no correction: half-way through the time
    /// `ahead`, and at its end.
    fn part_ahead(&self, speed: &PerAxis<f64>, ahead: Duration) -> f64 {
        // A periodic error may have the same value at the end as now, so half-way is checked too.
        let half = self.part_after(speed, ahead / 2);
        half.min(self.part_after(speed, ahead))
    }

    fn part_after(&self, speed: &PerAxis<f64>, time: Duration) -> f64 {
        let mut ahead_state = *self.state;
        for (q, speed) in ahead_state.q.iter_mut().zip(speed) {
            *q += speed * time.as_secs_f64();
        }
        let model = self.model;
        let then = model.wanted_by(self.only_thermal, &ahead_state, self.correctors, self.applied);
        let [linear, rotary] = self.compare(&then).map(|compare| compare.part());
        linear.min(rotary)
    }

    /// Compares the present correction with `then`, the correction required ahead: first the linear
    /// axes, then the rotary axes.
    fn compare(&self, then: &CoupledCorrection) -> [Comparison; 2] {
        let now = self.wanted;
        // Effect of the present linear corrections at the pose ahead, where the lever arms of the
        // rotary corrections differ.
        let mut does = now.position;
        let rows = now.follow.iter().zip(&then.follow).zip(&now.rotary);
        for ((now, then), share) in rows.filter(|(_, share)| **share != 0.0) {
            for ((does, now), then) in does.iter_mut().zip(now).zip(then) {
                *does += (now - then) * share;
            }
        }
        [
            Comparison::new(&does, &then.position, self.step(AxisKind::Linear)),
            Comparison::new(&now.rotary, &then.rotary, self.step(AxisKind::Rotary)),
        ]
    }

    fn step(&self, kind: AxisKind) -> f64 {
        let axes = self.limits.axes.iter().take(self.limits.count);
        let of_kind = axes.filter(|axis| axis.kind == kind);
        of_kind.map(|axis| axis.resolution).fold(0.0, f64::max)
    }
}

/// Size of a correction, and its distance from the required one, mm or rad; a distance of up to one step is
/// treated as zero.
struct Comparison {
    size: f64,
    differs: f64,
    step: f64,
}

impl Comparison {
    fn new(does: &PerAxis<f64>, needed: &PerAxis<f64>, step: f64) -> Self {
        let norm = |values: &PerAxis<f64>| values.iter().map(|x| x * x).sum::<f64>().sqrt();
        Self { size: norm(does), differs: norm(&PerAxis::from_fn(|i| does[i] - needed[i])), step }
    }

    fn part(&self) -> f64 {
        let differs = self.differs - self.step;
        if differs <= 0.5 * self.size { 1.0 } else { (2.0 * (1.0 - differs / self.size)).max(0.0) }
    }

    /// Whether the distance is at most `part` times the sum of the correction and two steps. Above 0.5 times the
    /// correction, the correction is reduced.
    fn is_within(&self, part: f64) -> bool {
        self.differs <= part * (self.size + 2.0 * self.step)
    }
}
