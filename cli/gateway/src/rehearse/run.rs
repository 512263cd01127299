//! Runs a gateway on a simulated machine with simulated time, and compares the motion of the axes with the rules.
//!
//! A run consists of start, arming, faults and observation.

use std::{
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_port::{
    Controller, MOST_WORDS, Words,
    inject::{Faults, Injection},
    simulated::SimulatedController,
};
use volcomp_runtime::{
    Cycle, CycleInput, PathPlan,
    guard::{Phase, Reasons, Request, State},
};
use volcomp_vocabulary::{AxisKind, Displacement, PerAxis, PerChannel};

use crate::{
    documents::{Excursion, RehearsedAxis, RehearsedFault, round},
    error::GatewayError,
    locked,
    plan::Plan,
    rehearse::machine::{Fault, FaultAction, Rig},
};

const CYCLES_BETWEEN: u64 = 100;
/// Maximum standstill for the test shift; then the machine moves to show that its positions change.
const STANDING: Duration = Duration::from_secs(8);
/// Correction written by another sender, as a multiple of the limit.
const GARBAGE: f64 = 1.5;
/// Maximum number of operator actions (acknowledging, arming) after a fault.
const MAX_ACTIONS: usize = 6;
const JUMP_K: f64 = 15.0;

pub(super) struct Run<'a> {
    plan: &'a Plan,
    pub(super) rig: Rig,
    cycle: Cycle,
    owner: u16,
    foreign: Option<SimulatedController>,
    random: ChaCha8Rng,
    cycles: u64,
    worst: State,
    rejected_position: bool,
}

/// Severity of a state, from which the worst state of a run is found.
fn rank(state: State) -> u8 {
    match state {
        State::Compensating => 0,
        State::Arming(_) => 1,
        State::Disarmed => 2,
        State::Holding(_) => 3,
        State::RampingOut(_) => 4,
        State::Faulted(_) => 5,
    }
}

impl<'a> Run<'a> {
    pub(super) fn new(
        plan: &'a Plan,
        path: &PathPlan,
        seed: u64,
        barrier_rate: i16,
    ) -> Result<Self, GatewayError> {
        let rig = Rig::new(plan, path, seed, barrier_rate)?;
        let owner = 1;
        Ok(Self {
            plan,
            cycle: rig.cycle(plan, owner)?,
            rig,
            owner,
            foreign: None,
            random: ChaCha8Rng::seed_from_u64(seed),
            cycles: 0,
            worst: State::Compensating,
            rejected_position: false,
        })
    }

    pub(super) fn state(&self) -> State {
        self.cycle.report().state
    }

    pub(super) fn reasons(&self) -> Reasons {
        self.cycle.report().reasons
    }

    pub(super) fn elapsed(&self) -> Duration {
        self.rig.clock.elapsed()
    }

    pub(super) fn worst(&self) -> State {
        self.worst
    }

    pub(super) fn rejected_position(&self) -> bool {
        self.rejected_position
    }

    pub(super) fn reset_axis_log(&self) {
        self.rig.controls.axes.forget();
    }

    pub(super) fn reset_worst_state(&mut self) {
        self.worst = self.state();
    }

    pub(super) fn step(&mut self, request: Option<Request>) {
        self.rig.clock.advance(self.plan.config.cycle());
        let asked = CycleInput { request, ..CycleInput::default() };
        let now = self.rig.clock.now();
        self.cycle.run(now, &asked, &mut || Duration::ZERO);
        self.cycles += 1;
        let report = self.cycle.report();
        self.rejected_position |= (report.outside_travel | report.jumped) != 0;
        if rank(self.state()) > rank(self.worst) {
            self.worst = self.state();
        }
    }

    pub(super) fn run(&mut self, time: Duration) {
        let end = self.elapsed() + time;
        while self.elapsed() < end {
            self.step(None);
        }
    }

    /// Repeats a request until the state changes or `most` has passed.
    fn ask(&mut self, request: Request, most: Duration) {
        let (before, end) = (self.state(), self.elapsed() + most);
        while self.state() == before && self.elapsed() < end {
            self.step(Some(request));
            for _ in 0..10 {
                if self.state() == before {
                    self.step(None);
                }
            }
        }
    }

    /// Arms, with the test shift if `proves`, and waits for the compensating state. Returns true if the state was
    /// reached.
    pub(super) fn arm(&mut self, most: Duration, proves: bool) -> bool {
        let end = self.elapsed() + most;
        let request = if proves { Request::Arm } else { Request::TakeOver };
        let mut standing = Duration::ZERO;
        let hold = Arc::clone(&self.rig.controls);
        while self.state() != State::Compensating && self.elapsed() < end {
            let proving = self.state() == State::Arming(Phase::Proving);
            hold.feed_hold.store(proving && standing < STANDING, Ordering::Relaxed);
            standing = if proving && standing < STANDING + Duration::from_secs(1) {
                standing + self.plan.config.cycle()
            } else {
                Duration::ZERO
            };
            let asks = self.state() == State::Disarmed && self.cycles.is_multiple_of(20);
            self.step(asks.then_some(request));
        }
        hold.feed_hold.store(false, Ordering::Relaxed);
        self.state() == State::Compensating
    }

    /// Arms and returns in the middle of the ramp. Returns false if that point was not reached.
    pub(super) fn arm_half(&mut self, most: Duration) -> bool {
        let end = self.elapsed() + most;
        let ramping = State::Arming(Phase::Ramping);
        while self.state() != ramping && self.elapsed() < end {
            let asks = self.cycles.is_multiple_of(20);
            self.step(asks.then_some(Request::TakeOver));
        }
        let half = self.rig.path.limits.ramp_taken() / 2;
        self.run(half);
        self.state() == ramping
    }

    /// Waits for the compensating state and performs the necessary operator actions, up to [`MAX_ACTIONS`]. Returns the
    /// time taken (`None` if the state was not reached) and the actions.
    pub(super) fn recover(&mut self, most: Duration) -> (Option<Duration>, Vec<&'static str>) {
        let (begun, mut needed) = (self.elapsed(), Vec::new());
        let unseen = Reasons::INTERLOCK_UNSEEN;
        let note = |needed: &mut Vec<&'static str>, what| {
            if needed.last() != Some(&what) {
                needed.push(what);
            }
        };
        let patience = Duration::from_secs(3);
        while self.elapsed() < begun + most && needed.len() <= MAX_ACTIONS {
            match self.state() {
                State::Compensating => return (Some(self.elapsed().saturating_sub(begun)), needed),
                State::Faulted(_) => {
                    note(&mut needed, "acknowledge");
                    self.ask(Request::Acknowledge, Duration::from_secs(5));
                }
                State::Disarmed => {
                    note(&mut needed, "arm");
                    self.ask(Request::TakeOver, Duration::from_secs(5));
                }
                State::Holding(_)
                    if self.reasons().contains(unseen) && self.elapsed() > begun + patience =>
                {
                    note(&mut needed, "acknowledge");
                    self.ask(Request::Acknowledge, Duration::from_secs(1));
                }
                // Disarming and arming accepts the present positions.
                State::Holding(_)
                    if self.reasons().contains(Reasons::JUMPED)
                        && self.elapsed() > begun + patience =>
                {
                    note(&mut needed, "disarm");
                    self.ask(Request::Disarm, Duration::from_secs(1));
                }
                _ => self.step(None),
            }
        }
        (None, needed)
    }

    /// Sets (`on`) or clears the switches of the machine for a fault.
    fn switch(&self, act: FaultAction, on: bool) {
        locked(&self.rig.wire).device.control.plant().pass();
        let controls = &self.rig.controls;
        let switch = match act {
            FaultAction::EmergencyStop
            | FaultAction::HiddenStop
            | FaultAction::HiddenStopByChance => &controls.emergency_stop,
            FaultAction::Alarm => &controls.alarm,
            FaultAction::Unreferenced => &controls.unreferenced,
            FaultAction::PositionsLost => &controls.disconnected,
            FaultAction::ProgramStopped => &self.rig.stopped,
            FaultAction::Reset if on => &controls.restart,
            FaultAction::PowerUp if on => &controls.clear_applied,
            _ => return,
        };
        switch.store(on, Ordering::Relaxed);
    }

    pub(super) fn disturb(&mut self, act: FaultAction) -> Result<(), GatewayError> {
        self.switch(act, true);
        let mut lasts = Duration::from_secs(2);
        match act {
            FaultAction::Chance(faults) => self.rig.inject(Injection::Faults(faults)),
            FaultAction::HeldBack => {
                for _ in 0..4 {
                    self.rig.inject(Injection::LateWrite { calls: u32::MAX });
                    self.run(Duration::from_millis(200));
                }
            }
            FaultAction::HiddenStop => {
                self.rig.inject(Injection::DroppedFlag { readings: u32::MAX });
            }
            FaultAction::HiddenStopByChance => self.rig.inject(Injection::Faults(Faults {
                dropped_flag: 0.02,
                calls: 20,
                ..Faults::default()
            })),
            FaultAction::PositionsLost => {
                lasts = self.rig.path.limits.zero_after + Duration::from_secs(1);
            }
            FaultAction::SensorJump => {
                self.rig.inject_sensor(Injection::Jump { sensor: 0, kelvin: JUMP_K });
            }
            FaultAction::SensorCorrupt => self
                .rig
                .inject_sensor(Injection::Faults(Faults { corrupt: 0.1, ..Faults::default() })),
            FaultAction::Restart => self.restart(Duration::from_millis(20))?,
            FaultAction::Garbage if self.rig.barrier.is_none() => self.overwrite(),
            _ => {}
        }
        let end = self.elapsed() + lasts;
        let begun = self.cycles;
        while self.elapsed() < end {
            if let FaultAction::Directed(injection) = act
                && (self.cycles - begun).is_multiple_of(CYCLES_BETWEEN)
            {
                self.rig.inject(injection);
            }
            if let FaultAction::OtherEnd { every, readings } = act
                && (self.cycles - begun).is_multiple_of(every)
            {
                self.inject_other_end(readings);
            }
            if matches!(act, FaultAction::Garbage) && self.rig.barrier.is_some() {
                self.post_garbage();
            }
            self.step(None);
        }
        self.restore(act)
    }

    /// In the next `readings` readings the position of the first axis is mirrored between the ends of its travel.
    fn inject_other_end(&self, readings: u32) {
        let model = &self.plan.model;
        let axes = self.rig.path.description.axes.first();
        let travel = axes.and_then(|axis| model.travel.get(model.index_of(axis.name)?));
        let Some(travel) = travel else { return };
        let [low, high] = travel.map(Displacement::mm_or_rad);
        self.rig.inject(Injection::WrongPosition {
            axis: 0,
            factor: -1.0,
            add: low + high,
            readings,
        });
    }

    fn restore(&mut self, act: FaultAction) -> Result<(), GatewayError> {
        self.switch(act, false);
        for injection in [
            Injection::Faults(Faults::default()),
            Injection::Lie { lie: volcomp_port::inject::Lie::Zero, readings: 0 },
            Injection::Constant { readings: 0 },
            Injection::FrozenPositions { readings: 0 },
            Injection::WrongPosition { axis: 0, factor: 1.0, add: 0.0, readings: 0 },
            Injection::DroppedFlag { readings: 0 },
            Injection::Disconnect { calls: 0 },
            Injection::Lag(0),
        ] {
            self.rig.inject(injection);
        }
        if matches!(act, FaultAction::HeldBack) {
            self.rig.inject(Injection::Release);
        }
        self.rig.inject_sensor(Injection::Faults(Faults::default()));
        if matches!(act, FaultAction::SensorJump) {
            self.rig.inject_sensor(Injection::Jump { sensor: 0, kelvin: 0.0 });
        }
        if matches!(act, FaultAction::Restart) {
            self.restart(Duration::from_secs(1))?;
        }
        Ok(())
    }

    /// Simulates a gateway that stops without ramping out and starts again after `gone` with its stored output.
    fn restart(&mut self, gone: Duration) -> Result<(), GatewayError> {
        let applied: PerAxis<f64> = self.cycle.report().correction;
        self.owner = self.owner.wrapping_add(1).max(1);
        self.cycle = self.rig.cycle(self.plan, self.owner)?;
        self.rig.clock.advance(gone);
        locked(&self.rig.wire).device.control.plant().pass();
        self.cycle.restore(&applied, gone);
        Ok(())
    }

    /// Simulates another sender that writes random words over a separate connection.
    fn post_garbage(&mut self) {
        let mut words = [0_u16; MOST_WORDS];
        let length = self.random.random_range(1..=MOST_WORDS);
        words.fill_with(|| self.random.random());
        if self.foreign.is_none() {
            self.foreign = locked(&self.rig.wire).device.control.another();
        }
        if let (Some(foreign), Some(words)) = (&mut self.foreign, Words::new(&words[..length])) {
            // A machine that is unreachable for the gateway is also unreachable for this sender, so ignore the error.
            let _ = foreign.post(&words, self.rig.clock.now());
        }
    }

    /// Simulates another sender that overwrites the words of the axes. The gateway does not cause that step, so the
    /// observation restarts after it.
    fn overwrite(&mut self) {
        let limits = &self.rig.path.limits;
        let signs: [bool; 2] = [self.random.random(), self.random.random()];
        let values = PerChannel::from_fn(|i| {
            if i >= limits.count {
                return 0.0;
            }
            let sign = if signs[i % 2] { 1.0 } else { -1.0 };
            sign * GARBAGE * limits.axes[i].limit
        });
        self.rig.overwrite(&values);
        self.rig.controls.axes.forget();
    }
}

/// Tolerance for rounding errors of summed steps, in steps.
const ROUNDING: f64 = 1e-6;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FaultPhase {
    Compensating,
    Ramping,
}

impl FaultPhase {
    fn name(self) -> &'static str {
        match self {
            Self::Compensating => "compensating",
            Self::Ramping => "ramping",
        }
    }
}

pub(super) struct Findings {
    pub(super) ready: bool,
    /// Time from the fault until the gateway compensated again; `None` if it did not.
    pub(super) again: Option<Duration>,
    pub(super) needed: Vec<&'static str>,
    pub(super) reasons: Reasons,
    pub(super) worst: State,
    pub(super) rejected_position: bool,
}

/// True if only the limit bounds the effect of a fault, because the fault causes an undetectable step.
fn is_bounded_by_limit(fault: &Fault, path: &PathPlan) -> bool {
    // Without read-back the gateway cannot detect that the control's words have changed.
    let is_unknown = path.no_read_back
        && matches!(
            fault.act,
            FaultAction::PowerUp | FaultAction::ProgramStopped | FaultAction::Garbage
        );
    path.barrier.is_none() && (fault.is_unseen_without_barrier || is_unknown)
}

/// True if the correction can be held during this fault: by the barrier, or by the gateway if its device reports the
/// condition that forbids motion.
fn can_hold(fault: &Fault, path: &PathPlan) -> bool {
    let shown = path.description.shown;
    let is_shown = match fault.act {
        FaultAction::EmergencyStop => shown.emergency_stop,
        FaultAction::Alarm => shown.alarm,
        FaultAction::Unreferenced => shown.referenced,
        _ => !fault.hides_interlock,
    };
    path.barrier.is_some() || is_shown
}

pub(super) fn judge(
    fault: &Fault,
    phase: FaultPhase,
    path: &PathPlan,
    rig: &Rig,
    findings: Findings,
) -> RehearsedFault {
    let log = &rig.controls.axes;
    let bounded_by_limit = is_bounded_by_limit(fault, path);
    let (changes, furthest) = (log.largest_change(), log.furthest());
    let period_s = path.limits.period.as_secs_f64();
    let (mut broken, mut axes) = (Vec::new(), Vec::new());
    for (place, axis) in path.description.axes.iter().enumerate() {
        let limits = &path.limits.axes[place];
        let overwritten = matches!(fault.act, FaultAction::Garbage) && rig.barrier.is_none();
        // The control applied the other sender's values, and the correction ramps from them.
        let most = if overwritten { limits.limit * GARBAGE } else { limits.reachable() };
        let allowed = match &rig.barrier {
            Some(barrier) => f64::from(barrier.rate[place]) * limits.resolution,
            None if bounded_by_limit => most + limits.limit,
            None => (limits.slew_per_s * period_s).max(limits.resolution),
        };
        let forgiven = if overwritten { limits.resolution } else { ROUNDING * limits.resolution };
        let (is_fast, is_far) = (
            changes[place] > allowed + ROUNDING * limits.resolution,
            furthest[place] > most + forgiven,
        );
        let (name, unit) = (axis.name, unit(axis.kind()));
        let shown = |value: f64| round(value * in_shown_unit(axis.kind()));
        let excursion = Excursion {
            largest_change: shown(changes[place]),
            allowed_change: shown(allowed),
            furthest: shown(furthest[place]),
            limit: shown(most),
        };
        if is_fast {
            broken.push(format!(
                "axis {name} moved by {} {unit} in one step, allowed {} {unit}",
                excursion.largest_change, excursion.allowed_change
            ));
        }
        if is_far {
            broken.push(format!(
                "axis {name} was corrected by {} {unit}, the limit is {} {unit}",
                excursion.furthest, excursion.limit
            ));
        }
        let is_linear = axis.kind() == AxisKind::Linear;
        axes.push(RehearsedAxis {
            axis: name,
            um: is_linear.then_some(excursion),
            urad: (!is_linear).then_some(excursion),
        });
    }
    let moved_while_held = log.changes_while_held();
    if moved_while_held > 0 && can_hold(fault, path) {
        broken.push(format!(
            "axes moved {moved_while_held} times in emergency stop, alarm or without reference"
        ));
    }
    let is_jump = matches!(fault.act, FaultAction::Directed(Injection::WrongPosition { add, .. }) if add != 0.0);
    if is_jump && findings.ready && !findings.rejected_position {
        broken.push("a position 4 m away was accepted: see rapid_m_per_min".to_owned());
    }
    if findings.again.is_none() {
        let reasons: Vec<&str> = findings.reasons.texts().collect();
        let when = if !findings.ready {
            "after the start within 30 s"
        } else if findings.needed.len() > MAX_ACTIONS {
            "again, despite repeated acknowledging and arming"
        } else {
            "again within 30 s"
        };
        broken.push(format!("it did not compensate {when}: {}", reasons.join(", ")));
    }
    RehearsedFault {
        fault: fault.name.to_owned(),
        meaning: fault.meaning.to_owned(),
        phase: phase.name().to_owned(),
        passed: broken.is_empty(),
        broken,
        bounded_by_limit,
        interlock_hidden: !can_hold(fault, path),
        state: findings.worst.name().to_owned(),
        compensating_after_s: findings.again.map(|time| round(time.as_secs_f64())),
        needed: findings.needed.into_iter().map(str::to_owned).collect(),
        moved_while_held,
        axes,
    }
}

pub(super) fn in_shown_unit(kind: AxisKind) -> f64 {
    match kind {
        AxisKind::Linear => 1e3,
        AxisKind::Rotary => 1e6,
    }
}

pub(super) fn unit(kind: AxisKind) -> &'static str {
    match kind {
        AxisKind::Linear => "µm",
        AxisKind::Rotary => "µrad",
    }
}
