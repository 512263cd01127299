//! The simulated machine that takes the place of a configured controller, and the way to it.

use std::{
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
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
    Axis, Clock, ControlProgram, Controller, Description, Fault, Snapshot, Words,
    inject::{Faults, Faulty},
    simulated::{self, Controls, Move, SimulatedController, SimulatedThermometer, Warming},
};
use volcomp_runtime::{Model, PathPlan, kinematics::State};
use volcomp_vocabulary::{AxisName, Displacement, PerChannel};

use crate::error::GatewayError;

/// The time of one move through the work space.
const MOVE_S: f64 = 4.0;
/// The time from standstill to feed.
const ACCELERATING_S: f64 = 0.4;

/// The way to a simulated machine, shared by the runs of a gateway and the rehearsal.
pub(super) type Way = Arc<Mutex<Faulty<Wire>>>;

/// A simulated machine and everything by which it can be disturbed.
pub(super) struct Rig {
    pub(super) clock: Clock,
    pub(super) way: Way,
    pub(super) controls: Arc<Controls>,
    /// The program of the control stands.
    pub(super) stopped: Arc<AtomicBool>,
    /// The barrier in the control, where it has one.
    pub(super) barrier: Option<Settings>,
}

/// A simulated control in the shape of a configured one.
pub(super) struct Wire {
    pub(super) control: SimulatedController,
    description: Description,
    stopped: Arc<AtomicBool>,
}

/// A controller that a cycle holds, while the rehearsal keeps the way.
pub(super) struct Held {
    description: Description,
    way: Way,
}

pub(super) fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The program of a control, which may be stopped: then its report stays as it is, and the axes stand.
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

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        let mut snapshot = self.control.read(deadline)?;
        if !self.description.tells_applied {
            snapshot.applied = None;
        }
        // What the configured device does not show is taken as the driver takes it.
        let shown = self.description.shown;
        snapshot.state.referenced |= !shown.referenced;
        snapshot.state.alarm &= shown.alarm;
        snapshot.state.emergency_stop &= shown.emergency_stop;
        Ok(snapshot)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        self.control.post(frame, deadline)
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        if self.stopped.load(Ordering::Relaxed) {
            // The words arrive, and nobody copies them to the axes.
            return Ok(());
        }
        self.control.apply(corrections, deadline)
    }
}

impl Held {
    pub(super) fn new(way: &Way) -> Self {
        Self {
            description: lock(way).device.description.clone(),
            way: Arc::clone(way),
        }
    }
}

impl Controller for Held {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        lock(&self.way).read(deadline)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        lock(&self.way).post(frame, deadline)
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        lock(&self.way).apply(corrections, deadline)
    }
}

impl Rig {
    /// A machine at its start, and its thermometer. The barrier in its control goes `rate` times as fast as it is said to:
    /// 1, except for tests of the rehearsal itself.
    ///
    /// # Errors
    /// Limits to which no barrier can be set.
    pub(super) fn new(
        model: &Model,
        plan: &PathPlan,
        sensors: &[String],
        seed: u64,
        rate: i16,
    ) -> Result<(Self, SimulatedThermometer), GatewayError> {
        let clock = Clock::manual();
        let (program, acceleration_per_s2) = moves(model, plan);
        let machine = simulated::Machine {
            axes: axes(&plan.description),
            program,
            acceleration_per_s2,
            sensors: sensors.iter().map(|name| warming(name)).collect(),
            truth: Arc::new(|_, _| PerChannel::ZERO),
            clock: clock.clone(),
        };
        let stopped = Arc::new(AtomicBool::new(false));
        let wrong = |source| GatewayError::Barrier {
            device: plan.description.device.clone(),
            source,
        };
        let barrier = barrier(plan)?;
        let (control, thermometer, controls) = match (barrier, plan.barrier) {
            (Some(settings), Some(at)) => {
                let faster = settings.rate.map(|counts| counts.saturating_mul(rate));
                let settings = Settings {
                    rate: faster,
                    ..settings
                };
                let program = Stoppable {
                    program: Program::new(settings).map_err(wrong)?,
                    stopped: Arc::clone(&stopped),
                    last: Words::EMPTY,
                };
                machine.start_with(Box::new(program), at.scan)
            }
            _ => machine.start(),
        };
        let wire = Wire {
            control,
            description: plan.description.clone(),
            stopped: Arc::clone(&stopped),
        };
        let faulty = Faulty::new(wire, Faults::default(), seed).with_clock(clock.clone());
        let rig = Self {
            way: Arc::new(Mutex::new(faulty)),
            clock,
            controls,
            stopped,
            barrier,
        };
        Ok((rig, thermometer))
    }
}

/// The axes of a simulated machine: those that are written, and those that are only read.
fn axes(description: &Description) -> Vec<Axis> {
    let only_read = |&name: &AxisName| Axis {
        name,
        includes_correction: false,
        resolution: Displacement::from_micro(name.kind(), 1.0),
        largest: None,
    };
    let written = description.axes.iter().copied();
    written
        .chain(description.reads.iter().map(only_read))
        .collect()
}

fn warming(name: &str) -> Warming {
    Warming {
        name: name.to_owned(),
        start_degc: 20.0,
        rise_k: 3.0,
        time_constant_s: 1800.0,
    }
}

/// Through the work space, all axes at once, from the corner where the correction is largest against its limit to the
/// corner opposite, and back; and the acceleration for it.
fn moves(model: &Model, plan: &PathPlan) -> (Vec<Move>, f64) {
    let (axes, written) = (
        plan.description.shown_axes().count(),
        plan.description.axes.len(),
    );
    let at = |corner: usize, place: usize| {
        let ends = model.travel.get(plan.machine_axis[place]);
        let [low, high] = ends
            .map(|ends| ends.map(Displacement::mm_or_rad))
            .unwrap_or_default();
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
    let corner = (0..=all)
        .max_by(|a, b| size(*a).total_cmp(&size(*b)))
        .unwrap_or(0);
    let ends = [corner, all ^ corner].map(|corner| {
        PerChannel::from_fn(|place| if place < axes { at(corner, place) } else { 0.0 })
    });
    let squares = ends[0].iter().zip(&ends[1]).map(|(a, b)| (a - b) * (a - b));
    let feed_per_s = squares.sum::<f64>().sqrt() / MOVE_S;
    let program = ends.map(|to| Move {
        to,
        feed_per_s,
        dwell: Duration::from_millis(500),
    });
    (program.to_vec(), feed_per_s / ACCELERATING_S)
}

/// The barrier in the control of a path; `None`: it has none.
///
/// # Errors
/// Limits to which no barrier can be set.
pub(super) fn barrier(plan: &PathPlan) -> Result<Option<Settings>, GatewayError> {
    let wrong = |source| GatewayError::Barrier {
        device: plan.description.device.clone(),
        source,
    };
    (plan.barrier)
        .map(|barrier| settings(plan, barrier.machine, barrier.scan))
        .transpose()
        .map_err(wrong)
}

/// The barrier as the machine builder sets it for these limits: the same limits, twice the slew, and times that the guard
/// accepts.
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
        // At least twice the slew: rounded up.
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
