//! A correction on a moving machine, and the resulting tool error.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{FollowResult, Limits, RequestedCorrection, Vector};
use volcomp_runtime::kinematics::State;
use volcomp_vocabulary::{AxisKind, PerAxis, PerChannel};

use super::cell::Cell;

/// The commanded position over time: constant, or all axes at constant rates.
pub(crate) struct Path {
    pub(crate) from: State,
    /// Rate of each axis, mm/s and rad/s.
    pub(crate) rate: PerAxis<f64>,
}

impl Path {
    pub(crate) fn new(cell: &Cell, rng: &mut ChaCha8Rng, moves: bool) -> Self {
        let feed: f64 = 10.0_f64.powf(rng.random_range(-1.0..=2.2));
        let turn: f64 = 10.0_f64.powf(rng.random_range(-3.0..=0.0));
        let mut rate = PerAxis::ZERO;
        for (rate, joint) in rate.iter_mut().zip(cell.machine.chain().joints()) {
            let most = match joint.kind {
                _ if !moves => 0.0,
                AxisKind::Linear => feed,
                AxisKind::Rotary => turn,
            };
            *rate = rng.random_range(-most..=most);
        }
        Self { from: cell.random_state(rng), rate }
    }

    pub(crate) fn at(&self, time_s: f64) -> State {
        let mut state = self.from;
        for (q, rate) in state.q.iter_mut().zip(self.rate) {
            *q += rate * time_s;
        }
        state
    }
}

/// Counts over all scenes of one kind.
#[derive(Default)]
pub(crate) struct Seen {
    pub(crate) cycles: usize,
    pub(crate) slewing: usize,
    pub(crate) behind: usize,
    pub(crate) limited: usize,
    pub(crate) arrived: usize,
    pub(crate) scenes: usize,
    /// Largest excess of the tool error over its bound, mm; negative: a margin.
    pub(crate) worst: Option<f64>,
    pub(crate) reported: String,
}

/// One test case: the vector under test, following the correction of a machine along a path, and the time so far.
pub(crate) struct Scene<'a> {
    pub(crate) cell: &'a Cell,
    pub(crate) limits: Limits,
    pub(crate) path: Path,
    pub(crate) vector: Vector,
    pub(crate) time_s: f64,
    /// Tool error at the start of the ramp or line, mm.
    pub(crate) began: f64,
    /// Correction at which the model was last evaluated.
    pub(crate) asked_at: PerChannel<f64>,
    /// Whether the next cycle starts a ramp.
    pub(crate) ramp_begins: bool,
    pub(crate) followed: FollowResult,
    /// Rate of the smooth values in the previous cycle, mm/s and rad/s.
    pub(crate) rate: PerChannel<f64>,
    /// Time (s) and correction words of each cycle.
    pub(crate) trace: Vec<(f64, PerChannel<f64>)>,
}

impl<'a> Scene<'a> {
    pub(crate) fn new(cell: &'a Cell, rng: &mut ChaCha8Rng, moves: bool, restarts: bool) -> Self {
        let limits = cell.random_limits(rng);
        let path = Path::new(cell, rng, moves);
        let applied = PerChannel::from_fn(|i| {
            let axis = &limits.axes[i];
            if i >= limits.count || !restarts {
                return 0.0;
            }
            let word = rng.random_range(-1.0..=1.0) * axis.reachable();
            (word / axis.resolution).round() * axis.resolution
        });
        Self {
            cell,
            limits,
            path,
            vector: Vector::at(&applied),
            time_s: 0.0,
            began: 0.0,
            asked_at: applied,
            ramp_begins: true,
            followed: FollowResult::default(),
            rate: PerChannel::ZERO,
            trace: vec![(0.0, applied)],
        }
    }

    /// Records the tool error at the start of a ramp or line, at the position of that cycle.
    pub(crate) fn begins(&mut self) {
        self.began = self.cell.off(&self.path.at(self.time_s), &self.vector.smooth());
    }

    /// Requests the correction with the errors at the actual position.
    pub(crate) fn wanted(&mut self, state: &State) -> RequestedCorrection {
        self.asked_at = self.vector.output();
        self.cell.wanted(state, &self.asked_at)
    }

    pub(crate) fn tick(&mut self, rng: &mut ChaCha8Rng) -> f64 {
        let periods = if rng.random_bool(0.9) { 1.0 } else { rng.random_range(0.3..=5.0) };
        periods * self.limits.period.as_secs_f64()
    }

    pub(crate) fn follow(&mut self, rng: &mut ChaCha8Rng, seen: &mut Seen) {
        let dt_s = self.tick(rng);
        self.time_s += dt_s;
        if core::mem::take(&mut self.ramp_begins) {
            self.begins();
        }
        let state = self.path.at(self.time_s);
        let wanted = self.wanted(&state);
        let before = self.vector;
        self.followed = self.vector.follow(&wanted, &self.limits, dt_s);
        seen.cycles += 1;
        seen.slewing += usize::from(self.followed.slewing);
        seen.limited += usize::from(self.followed.limited);
        self.holds_words(&before, dt_s);
        seen.behind += usize::from(self.followed.behind);
        if !self.followed.behind {
            self.judge(&state, seen);
        }
    }

    /// Asserts that every word is within its limit or approaches it, and every motion within slew and acceleration.
    pub(crate) fn holds_words(&mut self, before: &Vector, dt_s: f64) {
        for i in 0..self.limits.count {
            let axis = &self.limits.axes[i];
            let (word, stood) = (self.vector.output()[i], before.output()[i]);
            let most = (axis.limit + 1e-6 * axis.resolution).max(stood.abs());
            assert!(word.abs() <= most, "{word} over {most}");
            let rate = (self.vector.smooth()[i] - before.smooth()[i]) / dt_s;
            assert!(rate.abs() <= axis.slew_per_s * (1.0 + 1e-9), "{rate} of {axis:?}");
            let change = (rate - self.rate[i]).abs();
            assert!(
                change <= axis.accel_per_s2 * dt_s * (1.0 + 1e-6) + 1e-6 * axis.slew_per_s,
                "{} to {rate} in {dt_s}: {axis:?} {before:?} {:?}",
                self.rate[i],
                self.vector
            );
            self.rate[i] = rate;
        }
        self.trace.push((self.time_s, self.vector.output()));
    }

    /// Asserts that in any time window a word moves by at most slew × time plus one step.
    pub(crate) fn holds_in_windows(&self) {
        for (first, (start, from)) in self.trace.iter().enumerate() {
            for (end, to) in &self.trace[first..] {
                for (i, axis) in self.limits.axes.iter().take(self.limits.count).enumerate() {
                    let most = axis.slew_per_s * (end - start) + axis.resolution;
                    let way = (to[i] - from[i]).abs();
                    assert!(way <= most * (1.0 + 1e-9), "{way} from {start} to {end}");
                }
            }
        }
    }

    /// Lets this time pass without a write.
    pub(crate) fn stands(&mut self, time_s: f64) {
        self.vector.stop();
        self.rate = PerChannel::ZERO;
        self.time_s += time_s;
    }

    pub(crate) fn judge(&self, state: &State, seen: &mut Seen) {
        let cell = self.cell;
        let off = cell.off(state, &self.vector.output());
        let without = cell.off(state, &PerChannel::ZERO);
        // Second order: the remaining position error turns with the rotary corrections.
        let (mut turned, mut moved) = (0.0, self.began);
        for (share, axis) in self.vector.smooth().iter().zip(&self.limits.axes) {
            match axis.kind {
                AxisKind::Linear => moved += share.abs(),
                AxisKind::Rotary => turned += share.abs(),
            }
        }
        let bound = without.max(self.began)
            + cell.rounding(state, &self.vector, &self.limits)
            + turned * moved;
        let mut over = off - bound;
        if over > 0.0 {
            over -= cell.differs(state, [&self.vector.smooth(), &self.asked_at]);
        }
        if seen.worst.is_none_or(|worst| over > worst) {
            seen.worst = Some(over);
            seen.reported = format!(
                "{}: off {off}, without {without}, began {}, wanted {:?}, smooth {:?}, followed {:?}",
                cell.model.axes.iter().map(ToString::to_string).collect::<String>(),
                self.began,
                cell.wanted(state, &self.asked_at).full(),
                self.vector.smooth(),
                self.followed
            );
        }
    }
}
