//! The guard of one controller: inputs of a cycle in, the correction to write out.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{
    Inputs, Limits, LimitsError, Output, Quantity, Reading, Reasons,
    axis::Follower,
    limits::MOST_READ_BACK_CYCLES,
    proof::{Moves, Proof, Verdict},
    state::{Facts, Hold, Phase, Request, State},
    written::Written,
};

/// So many adopted read-backs in a row, without a write between that was there afterwards, make a fault.
const MOST_ADOPTED: u32 = 3;
/// A cycle counts as so many periods at the most.
const LONGEST_CYCLE_PERIODS: u32 = 5;

/// The guard of one controller: it decides which correction may reach the axes (rules of the crate's front page). It
/// keeps the last output, the ramp and the corrections that were written lately.
#[derive(Clone, Debug)]
pub struct Guard {
    limits: Limits,
    state: State,
    axes: PerChannel<Follower>,
    /// Where the ramp began, and how much of it has passed.
    from: PerChannel<f64>,
    ramp: f64,
    proof: Proof,
    moves: Moves,
    /// What the last proof showed.
    verdict: Verdict,
    written: Written,
    last_cycle: Option<Duration>,
    /// When positions and target were good last.
    good: Option<Duration>,
    adopted: u32,
    /// Writes that failed since the controller last said what is applied: whether it took them is not known.
    lost_writes: usize,
    /// Whether the controller can be asked what is applied: as it was when it answered last.
    can_be_asked: bool,
    held_back: u64,
}

impl Guard {
    /// A guard that is disarmed, its output zero.
    ///
    /// # Errors
    /// Limits that make no sense, or lie beyond a [`ceiling`](crate::ceiling).
    pub fn new(limits: Limits) -> Result<Self, LimitsError> {
        limits.check()?;
        Ok(Self {
            limits,
            state: State::Disarmed,
            axes: PerChannel::default(),
            from: PerChannel::ZERO,
            ramp: 1.0,
            proof: Proof::default(),
            moves: Moves::default(),
            verdict: Verdict::default(),
            written: Written::fill(&PerChannel::ZERO),
            last_cycle: None,
            good: None,
            adopted: 0,
            lost_writes: 0,
            can_be_asked: true,
            held_back: 0,
        })
    }

    /// Starts from a correction (mm, rad) that was stored before a restart, for controllers that cannot be asked for
    /// the correction they hold; to be called before the first cycle.
    pub fn restore(&mut self, applied: &PerChannel<f64>) {
        let finite = applied.map(|x| if x.is_finite() { x } else { 0.0 });
        self.stand_at(&finite);
    }

    /// Other limits from the next cycle on: outputs beyond them come back at the new slew rate.
    ///
    /// # Errors
    /// Limits that make no sense, lie beyond a [`ceiling`](crate::ceiling), or are of another number or kind of axes: the
    /// old ones stay.
    pub fn set_limits(&mut self, limits: Limits) -> Result<(), LimitsError> {
        limits.check()?;
        if limits.count != self.limits.count {
            let found = limits.count as f64;
            return Err(LimitsError {
                what: Quantity::Axes,
                axis: None,
                found,
                expected: "as many as before",
            });
        }
        let kinds = |limits: &Limits| limits.axes.map(|axis| axis.kind);
        if kinds(&limits)[..limits.count] != kinds(&self.limits)[..limits.count] {
            return Err(LimitsError {
                what: Quantity::Axes,
                axis: None,
                found: limits.count as f64,
                expected: "axes of the same kinds as before",
            });
        }
        self.limits = limits;
        Ok(())
    }

    /// The write of the last output failed: whether the controller took it the next read-back tells.
    pub fn write_failed(&mut self) {
        self.lost_writes = (self.lost_writes + 1).min(MOST_READ_BACK_CYCLES);
    }

    /// The limits that hold now.
    pub fn limits(&self) -> &Limits {
        &self.limits
    }

    /// The state after the last cycle.
    pub fn state(&self) -> State {
        self.state
    }

    /// What the test shift of the last arming showed, axis by axis.
    pub fn verdict(&self) -> &Verdict {
        &self.verdict
    }

    /// The last output, mm and rad.
    pub fn output(&self) -> PerChannel<f64> {
        self.axes.map(|axis| axis.output())
    }

    /// Decides one cycle: the correction to write, and the state.
    pub fn cycle(&mut self, inputs: &Inputs) -> Output {
        let dt = self.elapsed(inputs.now);
        let reading = inputs.reading.filter(|reading| self.is_finite(reading));
        let target = inputs
            .target
            .filter(|target| self.all(|i| target[i].is_finite()));
        let changed = inputs
            .reading
            .is_some_and(|reading| self.take_read_back(&reading));
        let facts = self.facts(inputs, reading.as_ref(), target.is_some(), changed);
        let before = self.state;
        self.state = before.next(&facts);
        if self.state != before && self.state == State::Arming(Phase::Proving) {
            self.verdict = Verdict::default();
        }
        if self.state != before || changed || inputs.request == Some(Request::Switched) {
            self.begin_ramp();
        }
        let mut reasons = self.reasons(inputs, reading.as_ref(), &facts);
        let write = self.is_written(inputs, &facts);
        if write {
            self.ramp += self.limits.ramp_share(dt);
            let goal = self.goal(target.as_ref(), &mut reasons);
            self.follow(&goal, dt, &mut reasons);
            self.written.push(&self.output());
        } else {
            self.axes.iter_mut().for_each(Follower::stop);
        }
        let correction = self.output();
        Output {
            correction,
            write,
            state: self.state,
            reasons,
            held_back: self.held_back,
        }
    }

    fn all(&self, holds: impl FnMut(usize) -> bool) -> bool {
        (0..self.limits.count).all(holds)
    }

    /// A position that is no number makes a reading worthless, but what it says of the controller counts.
    fn is_finite(&self, reading: &Reading) -> bool {
        self.all(|i| reading.positions[i].is_finite())
    }

    /// Time since the last cycle, s, at most five periods of it.
    fn elapsed(&mut self, now: Duration) -> f64 {
        let period = self.limits.period;
        let passed = self
            .last_cycle
            .map_or(period, |last| now.saturating_sub(last));
        self.last_cycle = Some(now);
        passed.min(period * LONGEST_CYCLE_PERIODS).as_secs_f64()
    }

    fn stand_at(&mut self, applied: &PerChannel<f64>) {
        self.axes = applied.map(Follower::at);
        self.from = *applied;
    }

    fn begin_ramp(&mut self) {
        self.from = self.axes.map(|axis| axis.smooth());
        self.ramp = 0.0;
        self.proof = Proof::default();
    }

    /// Takes the correction that the controller has applied (mm, rad) as the last output where it differs from the
    /// one that was written, and tells whether it did so.
    fn take_read_back(&mut self, reading: &Reading) -> bool {
        self.can_be_asked = reading.applied.is_some();
        let Some(applied) = reading.applied.filter(|a| self.all(|i| a[i].is_finite())) else {
            return false;
        };
        let differs = |i: usize, from: &PerChannel<f64>| {
            (applied[i] - from[i]).abs() > 0.51 * self.limits.axes[i].resolution
        };
        let last = self.limits.read_back_cycles;
        let lost = core::mem::take(&mut self.lost_writes);
        if self.written.holds(&applied, last, &self.limits) {
            let output = self.output();
            // It went where it was told to, away from where the ramp began.
            if self.all(|i| !differs(i, &output)) && !self.all(|i| !differs(i, &self.from)) {
                self.adopted = 0;
            }
            return false;
        }
        if lost > 0 && self.written.holds(&applied, last + lost, &self.limits) {
            // The writes that failed were not taken: on from there, which is no event.
            self.axes = applied.map(Follower::at);
            self.written = Written::fill(&applied);
            return false;
        }
        let writes = !matches!(
            self.state,
            State::Disarmed | State::Holding(Hold::Interlocked)
        );
        self.adopted = if writes {
            self.adopted.saturating_add(1)
        } else {
            0
        };
        self.stand_at(&applied);
        self.written = Written::fill(&applied);
        true
    }

    fn facts(
        &mut self,
        inputs: &Inputs,
        reading: Option<&Reading>,
        has_target: bool,
        changed: bool,
    ) -> Facts {
        if let (Some(reading), true) = (reading, has_target) {
            self.good = self.good.max(Some(reading.taken));
        }
        let age = self
            .good
            .map_or(Duration::MAX, |good| inputs.now.saturating_sub(good));
        let output = self.output();
        if let Some(reading) = reading {
            let applied = reading.applied.unwrap_or(output);
            self.moves
                .see(inputs.now, &reading.positions, &applied, &self.limits);
        }
        let proven = match (self.state, reading) {
            (State::Arming(Phase::Proving), Some(reading))
                if !changed && age <= self.limits.hold =>
            {
                self.proof.read(
                    inputs.now,
                    &reading.positions,
                    &output,
                    &self.from,
                    &self.limits,
                    &self.moves,
                )
            }
            _ => None,
        };
        self.verdict = proven.unwrap_or(self.verdict);
        let proven = proven.map(|verdict| !verdict.is_contradiction());
        let half_step = |i: usize| 0.5 * self.limits.axes[i].resolution;
        let agrees = |applied: PerChannel<f64>| {
            self.all(|i| (applied[i] - output[i]).abs() <= 1.02 * half_step(i))
        };
        Facts {
            request: inputs.request,
            // Until it answers again nobody knows better.
            interlocked: inputs
                .reading
                .map_or(self.state == State::Holding(Hold::Interlocked), |r| {
                    !r.referenced || r.alarm || r.emergency_stop
                }),
            stale: age > self.limits.hold,
            lost: age > self.limits.zero_after,
            changed,
            forbidden: !inputs.forbids.is_empty(),
            ramped: self.ramp >= 1.0,
            zero: self.all(|i| output[i].abs() <= half_step(i)),
            proves: self.proves(),
            proven,
            does_not_stick: self.adopted >= MOST_ADOPTED,
            agrees: reading.is_some_and(|reading| reading.applied.is_none_or(agrees)),
        }
    }

    fn proves(&self) -> bool {
        (0..self.limits.count).any(|i| self.limits.test_shift[i] > 0.0)
    }

    /// Whether the output is written. Not without a reading where the controller can be asked: it may have
    /// been cleared meanwhile, and the old correction would be a step.
    fn is_written(&self, inputs: &Inputs, facts: &Facts) -> bool {
        let active = !matches!(
            self.state,
            State::Disarmed | State::Holding(Hold::Interlocked)
        ) && !facts.interlocked;
        let known = match inputs.reading {
            Some(Reading {
                applied: Some(applied),
                ..
            }) => self.all(|i| applied[i].is_finite()),
            Some(_) => true,
            None => !self.can_be_asked,
        };
        active && known
    }

    /// Where the correction goes to, clamped.
    fn goal(&mut self, target: Option<&PerChannel<f64>>, reasons: &mut Reasons) -> PerChannel<f64> {
        let target = self.clamped(target, reasons);
        let smooth = self.axes.map(|axis| axis.smooth());
        let share = self.ramp.min(1.0);
        let ramp = |to: PerChannel<f64>| {
            PerChannel::from_fn(|i| self.from[i] + (to[i] - self.from[i]) * share)
        };
        let goal = match self.state {
            State::Arming(Phase::Proving) => self.proof.goal(&self.from, &self.limits),
            State::Arming(Phase::Ramping) => target.map_or(smooth, ramp),
            State::Compensating => target.unwrap_or(smooth),
            State::RampingOut(_) | State::Faulted(_) => ramp(PerChannel::ZERO),
            State::Disarmed | State::Holding(_) => smooth,
        };
        PerChannel::from_fn(|i| {
            let most = self.limits.axes[i].reachable();
            if i < self.limits.count {
                goal[i].clamp(-most, most)
            } else {
                0.0
            }
        })
    }

    fn clamped(
        &self,
        target: Option<&PerChannel<f64>>,
        reasons: &mut Reasons,
    ) -> Option<PerChannel<f64>> {
        let mut target = *target?;
        for (wanted, limits) in target
            .iter_mut()
            .zip(&self.limits.axes)
            .take(self.limits.count)
        {
            *reasons |= Reasons::WARN.when(wanted.abs() > limits.warn);
            *reasons |= Reasons::LIMITED.when(wanted.abs() > limits.limit);
            *wanted = wanted.clamp(-limits.limit, limits.limit);
        }
        Some(target)
    }

    fn follow(&mut self, goal: &PerChannel<f64>, dt: f64, reasons: &mut Reasons) {
        let mut held_back = false;
        let limits = self.limits.axes.iter().take(self.limits.count);
        for ((axis, goal), limits) in self.axes.iter_mut().zip(goal).zip(limits) {
            held_back |= axis.follow(*goal, limits, dt);
        }
        self.held_back += u64::from(held_back);
        *reasons |= Reasons::SLEWING.when(held_back);
    }

    fn reasons(&self, inputs: &Inputs, reading: Option<&Reading>, facts: &Facts) -> Reasons {
        let mut reasons = self.state.reason();
        reasons |= Reasons::NO_CONTROLLER.when(inputs.reading.is_none());
        reasons |= Reasons::NOT_A_NUMBER.when(
            inputs.reading.is_some() && reading.is_none()
                || inputs
                    .target
                    .is_some_and(|t| !self.all(|i| t[i].is_finite())),
        );
        reasons |= Reasons::POSITIONS_STALE.when(facts.stale);
        reasons |= Reasons::READ_BACK.when(facts.changed && self.state != State::Disarmed);
        reasons |= Reasons::CORRECTION_LEFT.when(self.state == State::Disarmed && !facts.zero);
        reasons |=
            Reasons::WAITING_FOR_STANDSTILL.when(self.state == State::Arming(Phase::Proving));
        let shown = |i: usize| self.verdict.proven[i] || self.limits.test_shift[i] == 0.0;
        let after = !matches!(self.state, State::Disarmed | State::Arming(Phase::Proving));
        reasons |= Reasons::NOT_PROVEN.when(!facts.proves || after && !self.all(shown));
        if let Some(reading) = reading {
            reasons |= Reasons::NOT_REFERENCED.when(!reading.referenced);
            reasons |= Reasons::CONTROLLER_ALARM.when(reading.alarm);
            reasons |= Reasons::EMERGENCY_STOP.when(reading.emergency_stop);
        }
        reasons
    }
}
