//! The simulated machine that replaces a configured controller, its connection, and the catalogue of faults.
//!
//! The faults are those of the machine, the connection and the gateway.

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_guard::{
    RATE_OVER_SLEW,
    barrier::{Program, Settings, SettingsError},
    protocol::{Counts, Layout},
};
use volcomp_port::{
    Axis, Clock, ControlProgram, Controller, Description, Snapshot, Temperature, Thermometer,
    Words,
    inject::{Faults, Faulty, Injection, Lie},
    simulated::{self, Controls, Move, SimulatedController, SimulatedThermometer, Warming},
};
use volcomp_runtime::{
    ControlPath, Cycle, Model, PathPlan, Rapid, Sensors, kinematics::State, next_owner,
};
use volcomp_vocabulary::{AxisName, Displacement, PerChannel};

use crate::{
    error::GatewayError,
    locked,
    plan::{OpenedPlan, Plan},
};

/// Duration of one move through the working volume, s.
const MOVE_S: f64 = 4.0;
const ACCELERATING_S: f64 = 0.4;

type SharedWire = Arc<Mutex<Faulty<Wire>>>;

/// A simulated machine in place of a configured one, with the handles to inject faults. Its clock
/// is advanced explicitly.
pub struct Rig {
    pub(super) path: PathPlan,
    pub(super) clock: Clock,
    pub(super) wire: SharedWire,
    pub(super) thermometer: Option<ThermometerLink>,
    /// Switches of the machine and the record of its axis motion.
    pub controls: Arc<Controls>,
    pub(super) stopped: Arc<AtomicBool>,
    pub(super) barrier: Option<Settings>,
}

pub(super) struct Wire {
    pub(super) control: SimulatedController,
    description: Description,
    stopped: Arc<AtomicBool>,
}

struct SharedController {
    description: Description,
    wire: SharedWire,
}

/// A control program that can be stopped. While it is stopped, its report and its outputs do not change.
struct Stoppable {
    program: Program,
    stopped: Arc<AtomicBool>,
    last: Words,
}

impl ControlProgram for Stoppable {
    fn scan(&mut self, mailboxes: &[&[u16]], holds: bool) -> Words {
        if !self.stopped.load(Ordering::Relaxed) {
            self.last = self.program.scan(mailboxes, holds);
        }
        self.last
    }

    fn applied(&self) -> PerChannel<i16> {
        self.program.applied()
    }

    fn restart(&mut self, applied: &PerChannel<i16>) {
        self.program.restart(applied);
    }
}

impl Controller for Wire {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, volcomp_port::Fault> {
        let mut snapshot = self.control.read(deadline)?;
        if !self.description.tells_applied {
            snapshot.applied = None;
        }
        // A state that the configured device does not report has the default value of its driver.
        let shown = self.description.shown;
        snapshot.state.referenced |= !shown.referenced;
        snapshot.state.alarm &= shown.alarm;
        snapshot.state.emergency_stop &= shown.emergency_stop;
        Ok(snapshot)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), volcomp_port::Fault> {
        self.control.post(frame, deadline)
    }

    fn apply(
        &mut self,
        corrections: &PerChannel<f64>,
        deadline: Instant,
    ) -> Result<(), volcomp_port::Fault> {
        if self.stopped.load(Ordering::Relaxed) {
            // The control receives the words, but the stopped program does not apply them.
            return Ok(());
        }
        self.control.apply(corrections, deadline)
    }
}

impl SharedController {
    fn new(wire: &SharedWire) -> Self {
        Self { description: locked(wire).device.description.clone(), wire: Arc::clone(wire) }
    }
}

impl Controller for SharedController {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, volcomp_port::Fault> {
        locked(&self.wire).read(deadline)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), volcomp_port::Fault> {
        locked(&self.wire).post(frame, deadline)
    }

    fn apply(
        &mut self,
        corrections: &PerChannel<f64>,
        deadline: Instant,
    ) -> Result<(), volcomp_port::Fault> {
        locked(&self.wire).apply(corrections, deadline)
    }
}

impl Rig {
    /// Creates a machine in its initial state, in place of the first controller of a plan.
    ///
    /// # Errors
    /// The limits do not give valid settings of a barrier, or the plan has no controller.
    pub fn of(plan: &Plan) -> Result<Self, GatewayError> {
        let path = plan.paths().first();
        let path = path.ok_or_else(|| GatewayError::invalid("no controller, expected one"))?;
        Self::new(plan, path, 1, 1)
    }

    /// Creates a machine in its initial state, with its thermometer. The barrier in its control moves at `rate` times
    /// the rate of its settings; `rate` is 1, except in tests of the rehearsal.
    ///
    /// # Errors
    /// The limits do not give valid settings of a barrier.
    pub(super) fn new(
        plan: &Plan,
        path: &PathPlan,
        seed: u64,
        rate: i16,
    ) -> Result<Self, GatewayError> {
        let (model, mut path) = (&plan.model, path.clone());
        // An axis whose position only another controller reports is fixed at mid-travel.
        for (index, ends) in model.travel.iter().enumerate() {
            let shown = path.description.shows(model.axes[index]);
            if !shown && path.fixed[index].is_none() {
                let [low, high] = ends.map(Displacement::mm_or_rad);
                path.fixed[index] = Some(0.5 * (low + high));
            }
        }
        let clock = Clock::manual();
        let (program, acceleration_per_s2) = moves(model, &path, &plan.guard().rapid);
        let machine = simulated::Machine {
            axes: axes(&path.description),
            program,
            acceleration_per_s2,
            sensors: plan.sensors.iter().map(|name| warming(name)).collect(),
            truth: Arc::new(|_, _| PerChannel::ZERO),
            clock: clock.clone(),
        };
        let stopped = Arc::new(AtomicBool::new(false));
        let wrong =
            |source| GatewayError::Barrier { device: path.description.device.clone(), source };
        let barrier = barrier(&path)?;
        let (control, thermometer, controls) = match (barrier, path.barrier) {
            (Some(settings), Some(at)) => {
                let faster = settings.rate.map(|counts| counts.saturating_mul(rate));
                let settings = Settings { rate: faster, ..settings };
                let program = Stoppable {
                    program: Program::new(settings).map_err(wrong)?,
                    stopped: Arc::clone(&stopped),
                    last: Words::EMPTY,
                };
                machine.start_with(Box::new(program), at.scan)
            }
            _ => machine.start(),
        };
        let wire =
            Wire { control, description: path.description.clone(), stopped: Arc::clone(&stopped) };
        let faulty = Faulty::new(wire, Faults::default(), seed).with_clock(clock.clone());
        let thermometer = (!plan.sensors.is_empty()).then(|| {
            let faulty = Faulty::new(thermometer, Faults::default(), seed);
            Arc::new(Mutex::new(faulty.with_clock(clock.clone())))
        });
        Ok(Self {
            path,
            clock,
            wire: Arc::new(Mutex::new(faulty)),
            thermometer,
            controls,
            stopped,
            barrier,
        })
    }

    /// Builds the cycle of a gateway for this machine; `owner` is the owner number of the gateway.
    ///
    /// # Errors
    /// The plan and the machine do not match.
    pub(super) fn cycle(&self, plan: &Plan, owner: u16) -> Result<Cycle, GatewayError> {
        let wrong = |source| plan.config.plan_error(source);
        let held = SharedController::new(&self.wire);
        let control = ControlPath::new(Box::new(held), &self.path).map_err(wrong)?;
        let thermometer = self.thermometer.as_ref().map(SharedThermometer::new);
        let thermometers = thermometer.map(|held| Box::new(held) as Box<dyn Thermometer>);
        let guard = plan.guard();
        let cycle = Cycle::new(
            Box::new(plan.model.clone()),
            vec![control.with_owner(&self.path, owner).map_err(wrong)?],
            guard.hand_back,
            Sensors::new(thermometers.into_iter().collect(), guard.temperatures),
            plan.config.cycle(),
        )
        .map_err(wrong)?;
        Ok(cycle.with_rapid(guard.rapid).with_clock(self.clock.clone()))
    }

    /// Opens a plan in which this machine replaces the first controller and the thermometers. Tests use it to run a
    /// complete gateway in one process.
    ///
    /// # Errors
    /// The plan and the machine do not match.
    pub fn open(&self, plan: Plan) -> Result<OpenedPlan, GatewayError> {
        let cycle = self.cycle(&plan, next_owner())?;
        Ok(plan.opened(cycle))
    }

    /// Clock of the machine. It moves only when the caller advances it.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Injects a fault into the connection to the control.
    pub fn inject(&self, injection: Injection) {
        locked(&self.wire).inject(injection);
    }

    /// Simulates another sender that writes these values (mm, rad) to the axes.
    pub fn overwrite(&self, values: &PerChannel<f64>) {
        // A machine that is unreachable for the gateway is also unreachable for this sender, so ignore the error.
        let _ = locked(&self.wire).device.control.apply(values, self.clock.now());
    }

    /// Injects a fault into the thermometer.
    pub fn inject_sensor(&self, injection: Injection) {
        if let Some(shared) = &self.thermometer {
            locked(shared).inject(injection);
        }
    }
}

/// The thermometer with its faults, shared by the gateway and the rehearsal. It survives a restart of the gateway.
type ThermometerLink = Arc<Mutex<Faulty<SimulatedThermometer>>>;

struct SharedThermometer {
    device: String,
    names: Vec<String>,
    shared: ThermometerLink,
    latest: Vec<Temperature>,
}

impl SharedThermometer {
    fn new(shared: &ThermometerLink) -> Self {
        let (device, names) = {
            let faulty = locked(shared);
            (faulty.device().to_owned(), faulty.names().to_vec())
        };
        Self {
            device,
            latest: vec![Temperature::NOT_READ; names.len()],
            names,
            shared: Arc::clone(shared),
        }
    }
}

impl Thermometer for SharedThermometer {
    fn device(&self) -> &str {
        &self.device
    }

    fn names(&self) -> &[String] {
        &self.names
    }

    fn latest(&mut self) -> &[Temperature] {
        self.latest.clear();
        self.latest.extend_from_slice(locked(&self.shared).latest());
        &self.latest
    }
}

/// The axes of a control: the written axes first, then those that are only read.
fn axes(description: &Description) -> Vec<Axis> {
    let only_read = |&name: &AxisName| Axis {
        name,
        includes_correction: false,
        resolution: Displacement::from_micro(name.kind(), 1.0),
        largest: None,
    };
    let written = description.axes.iter().copied();
    written.chain(description.reads.iter().map(only_read)).collect()
}

fn warming(name: &str) -> Warming {
    Warming { name: name.to_owned(), start_degc: 20.0, rise_k: 3.0, time_constant_s: 1800.0 }
}

/// Moves all axes simultaneously through the working volume: from the corner where the correction is largest relative
/// to its limit, toward the opposite corner as far as the rapid speeds allow in [`MOVE_S`], and back. Also returns the
/// acceleration along the path, mm/s² (rad/s² for rotary axes).
fn moves(model: &Model, plan: &PathPlan, rapid: &Rapid) -> (Vec<Move>, f64) {
    let (axes, written) = (plan.description.shown_axes().count(), plan.description.axes.len());
    let at = |corner: usize, place: usize| {
        let ends = model.travel.get(plan.machine_axis[place]);
        let [low, high] = ends.map(|ends| ends.map(Displacement::mm_or_rad)).unwrap_or_default();
        if corner >> place & 1 == 0 { high } else { low }
    };
    let size = |corner: usize| {
        let mut state = State::default();
        for (axis, fixed) in plan.fixed.iter().enumerate() {
            state.q[axis] = fixed.unwrap_or(0.0);
        }
        for place in 0..axes {
            state.q[plan.machine_axis[place]] = at(corner, place);
        }
        let wanted = model.correction_of(&state, &plan.correctors).delta;
        let share = |i: usize| (wanted[plan.machine_axis[i]] / plan.limits.axes[i].limit).abs();
        (0..written).map(share).fold(0.0, f64::max)
    };
    let all = (1_usize << axes) - 1;
    let corner = (0..=all).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(0);
    let travelled = |place: usize| at(all ^ corner, place) - at(corner, place);
    // The guard rejects the positions of an axis that is faster.
    let reach = |place: usize| {
        let kind = model.axes[plan.machine_axis[place]].kind();
        rapid.per_s(kind).mm_or_rad() * MOVE_S / travelled(place).abs()
    };
    let share = (0..axes).map(reach).fold(1.0, f64::min);
    let ends = [0.0, share].map(|share| {
        let moved = |place: usize| at(corner, place) + share * travelled(place);
        PerChannel::from_fn(|place| if place < axes { moved(place) } else { 0.0 })
    });
    let squares = ends[0].iter().zip(&ends[1]).map(|(a, b)| (a - b) * (a - b));
    let feed_per_s = squares.sum::<f64>().sqrt() / MOVE_S;
    let program = ends.map(|to| Move { to, feed_per_s, dwell: Duration::from_millis(500) });
    (program.to_vec(), feed_per_s / ACCELERATING_S)
}

/// Settings of the barrier in the control of a path; `None`: the control has no barrier.
///
/// # Errors
/// The limits do not give valid settings of a barrier.
pub(super) fn barrier(plan: &PathPlan) -> Result<Option<Settings>, GatewayError> {
    let wrong = |source| GatewayError::Barrier { device: plan.description.device.clone(), source };
    (plan.barrier)
        .map(|barrier| settings(plan, barrier.machine, barrier.scan))
        .transpose()
        .map_err(wrong)
}

/// Settings that a machine builder would choose for these limits: the same limits, twice the slew rate, and times that
/// the guard accepts.
fn settings(plan: &PathPlan, machine: u16, scan: Duration) -> Result<Settings, SettingsError> {
    let limits = &plan.limits;
    let names = plan.description.axes.iter().map(|axis| axis.name);
    let layout = Layout::of(names)?;
    let axes = || limits.axes.iter().take(limits.count).enumerate();
    let in_a_scan = |axis: &volcomp_runtime::guard::AxisLimits| {
        RATE_OVER_SLEW * axis.slew_per_s * scan.as_secs_f64() / axis.resolution
    };
    let slowest = axes().map(|(_, axis)| 1.0 / in_a_scan(axis));
    let step_scans = slowest.fold(1.0, f64::max).ceil();
    let (mut limit, mut rate) = (Counts::default(), Counts::default());
    for (place, axis) in axes() {
        limit[place] = count((axis.reachable() / axis.resolution).round());
        // Round up to at least twice the slew rate.
        rate[place] = count((in_a_scan(axis) * step_scans - 1e-9).ceil());
    }
    let scans = |time: Duration| time.as_secs_f64() / scan.as_secs_f64();
    let hold = limits.hold.min(limits.zero_after / 2);
    let hold_scans = scans(hold).floor().max(1.0);
    let time_out = (2.0 * hold_scans).max(scans(Duration::from_millis(200)).ceil());
    let time_out = time_out.min(scans(limits.zero_after).floor());
    Ok(Settings {
        axes: layout,
        machine,
        limit,
        rate,
        step_scans: count(step_scans).unsigned_abs(),
        hold_scans: count(hold_scans).unsigned_abs(),
        time_out_scans: count(time_out).unsigned_abs(),
    })
}

#[expect(clippy::cast_possible_truncation, reason = "held within the range")]
fn count(number: f64) -> i16 {
    number.clamp(0.0, f64::from(i16::MAX)) as i16
}

#[derive(Clone, Copy, Debug)]
pub struct Fault {
    /// Name, as given to `--fault`.
    pub name: &'static str,
    /// Description of the fault.
    pub meaning: &'static str,
    pub(super) act: FaultAction,
    /// True if the fault causes a step that cannot be detected without a barrier; only the limit bounds the step.
    pub(super) is_unseen_without_barrier: bool,
    /// True if the gateway reads that the machine may be moved although it may not; only a barrier can hold the
    /// correction then.
    pub(super) hides_interlock: bool,
}

#[derive(Clone, Copy, Debug)]
pub(super) enum FaultAction {
    Nothing,
    Chance(Faults),
    Directed(Injection),
    /// Once every `every` cycles, the next `readings` readings report the position of the first axis mirrored
    /// between the ends of its travel.
    OtherEnd {
        every: u64,
        readings: u32,
    },
    /// Writes are delayed and all delivered at the end.
    HeldBack,
    EmergencyStop,
    Alarm,
    Unreferenced,
    /// The emergency stop is pressed, but readings do not show it.
    HiddenStop,
    /// As `HiddenStop`, but at random times.
    HiddenStopByChance,
    /// The control restarts; its words keep their values.
    Reset,
    /// The control is power-cycled; its words are cleared.
    PowerUp,
    ProgramStopped,
    Garbage,
    /// The gateway is killed without ramping out, then restarted.
    Restart,
    /// The connection is lost for longer than the guard accepts missing positions.
    PositionsLost,
    /// A temperature jumps by 15 K.
    SensorJump,
    SensorCorrupt,
}

const NONE: Faults = Faults {
    delay: Duration::ZERO,
    jitter: false,
    drop: 0.0,
    corrupt: 0.0,
    freeze: 0.0,
    disconnect: 0.0,
    calls: 20,
    lie: 0.0,
    constant: 0.0,
    late_write: 0.0,
    double_write: 0.0,
    torn_write: 0.0,
    reordered_write: 0.0,
    late_answer: 0.0,
    frozen_positions: 0.0,
    stop_after_read: 0.0,
    stop_before_write: 0.0,
    stop: Duration::from_millis(800),
    dropped_flag: 0.0,
    flicker: 0.0,
    lag: 0,
};

/// Probability of a random fault per call.
const CHANCE: f64 = 0.1;
/// Probability per call of a random fault that lasts or stops the control.
const SELDOM: f64 = 0.02;

const ALL: Faults = Faults {
    drop: SELDOM,
    corrupt: SELDOM,
    freeze: SELDOM,
    disconnect: 0.005,
    lie: SELDOM,
    constant: SELDOM,
    late_write: SELDOM,
    double_write: SELDOM,
    torn_write: SELDOM,
    reordered_write: SELDOM,
    late_answer: SELDOM,
    frozen_positions: SELDOM,
    stop_after_read: 0.002,
    stop_before_write: 0.002,
    flicker: SELDOM,
    ..NONE
};

const fn fault(name: &'static str, meaning: &'static str, act: FaultAction) -> Fault {
    Fault { name, meaning, act, is_unseen_without_barrier: false, hides_interlock: false }
}

const fn unseen(name: &'static str, meaning: &'static str, act: FaultAction) -> Fault {
    Fault { is_unseen_without_barrier: true, ..fault(name, meaning, act) }
}

const fn hiding(name: &'static str, meaning: &'static str, act: FaultAction) -> Fault {
    Fault { hides_interlock: true, ..fault(name, meaning, act) }
}

const fn lie(lie: Lie) -> FaultAction {
    FaultAction::Directed(Injection::Lie { lie, readings: 5 })
}

/// A wrong position of the first axis: `factor` · position + `add`.
const fn wrong_position(factor: f64, add: f64) -> FaultAction {
    FaultAction::Directed(Injection::WrongPosition { axis: 0, factor, add, readings: 20 })
}

/// All faults, in the order of the rehearsal.
#[rustfmt::skip]
pub const CATALOGUE: &[Fault] = &[
    fault("none", "no fault: start, ramp, correction", FaultAction::Nothing),
    // Random faults.
    fault("delay", "a busy network", FaultAction::Chance(Faults { delay: Duration::from_millis(1), jitter: true, ..NONE })),
    fault("drop", "answers that are lost", FaultAction::Chance(Faults { drop: CHANCE, ..NONE })),
    fault("corrupt", "positions that are wrong or no number", FaultAction::Chance(Faults { corrupt: CHANCE, ..NONE })),
    unseen("freeze", "a module that answers from its memory", FaultAction::Chance(Faults { freeze: SELDOM, ..NONE })),
    fault("disconnect", "a cable that is pulled and plugged in", FaultAction::Chance(Faults { disconnect: SELDOM, ..NONE })),
    unseen("lie", "read-backs that are wrong", FaultAction::Chance(Faults { lie: CHANCE, ..NONE })),
    unseen("constant", "read-backs that stay as they are", FaultAction::Chance(Faults { constant: SELDOM, ..NONE })),
    unseen("late_write", "writes that arrive late", FaultAction::Chance(Faults { late_write: CHANCE, ..NONE })),
    unseen("double_write", "writes that arrive twice", FaultAction::Chance(Faults { double_write: CHANCE, ..NONE })),
    fault("torn_write", "words read while they are written", FaultAction::Chance(Faults { torn_write: CHANCE, ..NONE })),
    unseen("reordered_write", "writes that overtake one another", FaultAction::Chance(Faults { reordered_write: CHANCE, ..NONE })),
    fault("late_answer", "answers just within the deadline", FaultAction::Chance(Faults { late_answer: CHANCE, ..NONE })),
    fault("frozen_positions", "positions that stay as they are", FaultAction::Chance(Faults { frozen_positions: SELDOM, ..NONE })),
    fault("stop_after_read", "the program pauses after a reading", FaultAction::Chance(Faults { stop_after_read: SELDOM, ..NONE })),
    fault("stop_before_write", "the program pauses before a write", FaultAction::Chance(Faults { stop_before_write: SELDOM, ..NONE })),
    hiding("dropped_flag", "an emergency stop that is seen at times", FaultAction::HiddenStopByChance),
    fault("flicker", "a count that flickers", FaultAction::Chance(Faults { flicker: CHANCE, ..NONE })),
    fault("lag", "positions five readings late", FaultAction::Chance(Faults { lag: 5, ..NONE })),
    unseen("all", "all of these at once", FaultAction::Chance(ALL)),
    // Injected faults.
    fault("lie_value", "five read-backs with a wrong value", lie(Lie::Value)),
    fault("lie_not_a_number", "five read-backs that are no number", lie(Lie::NotANumber)),
    unseen("lie_other_axis", "five read-backs of another axis", lie(Lie::OtherAxis)),
    fault("lie_torn", "five read-backs that are torn", lie(Lie::Torn)),
    unseen("lie_zero", "five read-backs of zero", lie(Lie::Zero)),
    unseen("constant_100", "100 read-backs that stay as they are", FaultAction::Directed(Injection::Constant { readings: 100 })),
    unseen("late_write_50", "a write that arrives 50 calls late", FaultAction::Directed(Injection::LateWrite { calls: 50 })),
    unseen("double_write_50", "a write that arrives again after 50 calls", FaultAction::Directed(Injection::DoubleWrite { calls: 50 })),
    fault("torn_write_one", "single writes that are torn", FaultAction::Directed(Injection::TornWrite)),
    unseen("reordered_one", "single writes that are overtaken", FaultAction::Directed(Injection::ReorderedWrite)),
    unseen("held_back", "writes that arrive after seconds", FaultAction::HeldBack),
    fault("late_answer_one", "single answers that are late", FaultAction::Directed(Injection::LateAnswer(Duration::from_millis(100)))),
    fault("frozen_100", "100 readings of the same position", FaultAction::Directed(Injection::FrozenPositions { readings: 100 })),
    fault("position_jump", "20 readings of a position 4 m away", wrong_position(1.0, 4000.0)),
    fault("position_jump_within", "20 readings of a position elsewhere in the travel", FaultAction::OtherEnd { every: 100, readings: 20 }),
    fault("position_alternates", "every other position is elsewhere in the travel", FaultAction::OtherEnd { every: 2, readings: 1 }),
    fault("position_inches", "20 readings of a position in inches", wrong_position(1.0 / 25.4, 0.0)),
    fault("stop_read_2s", "the program pauses for 2 s after a reading", FaultAction::Directed(Injection::StopAfterRead(Duration::from_secs(2)))),
    fault("stop_write_2s", "the program pauses for 2 s before a write", FaultAction::Directed(Injection::StopBeforeWrite(Duration::from_secs(2)))),
    hiding("hidden_stop", "an emergency stop that is not seen", FaultAction::HiddenStop),
    fault("flicker_one", "single counts that flicker", FaultAction::Directed(Injection::Flicker { axis: 0 })),
    fault("lag_20", "positions 20 readings late", FaultAction::Directed(Injection::Lag(20))),
    fault("disconnect_50", "50 calls without a connection", FaultAction::Directed(Injection::Disconnect { calls: 50 })),
    // Faults of the control, the gateway and the sensors.
    fault("emergency_stop", "the emergency stop is pressed", FaultAction::EmergencyStop),
    fault("alarm", "the control has an alarm", FaultAction::Alarm),
    fault("unreferenced", "the axes lose their reference", FaultAction::Unreferenced),
    fault("reset", "the control starts anew", FaultAction::Reset),
    fault("power_up", "the control is switched off and on", FaultAction::PowerUp),
    fault("program_stopped", "the program in the control stops", FaultAction::ProgramStopped),
    fault("garbage", "another sender writes random words", FaultAction::Garbage),
    fault("restart", "the gateway is ended and started anew", FaultAction::Restart),
    fault("positions_lost", "the connection is gone for long", FaultAction::PositionsLost),
    fault("sensor_jump", "a temperature jumps by 15 K", FaultAction::SensorJump),
    fault("sensor_corrupt", "temperatures that are wrong or no number", FaultAction::SensorCorrupt),
];
