//! A five-axis machine at one position, with a control that names its axes in another order.

use std::{
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::{Fading, Machine};
use volcomp_port::{
    Axis, Clock, Controller, ControllerState, Description, Fault, Heartbeat, ShownStates, Snapshot,
    simulated,
};
use volcomp_runtime::{
    AxisSettings, ControlPath, Cycle, CycleInput, GuardSettings, Model, PathPlan, PathSettings,
    PlanError, Replacement, Report, Sensors, ToolError, WithoutBarrier,
    guard::{Limits, Request},
};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerChannel, Um, Urad};

pub(crate) const PERIOD: Duration = Duration::from_millis(4);
pub(crate) const NAMES: [AxisName; 5] =
    [AxisName::Z, AxisName::B, AxisName::X, AxisName::C, AxisName::Y];

pub(crate) fn machine_file() -> String {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/five-axis.toml");
    std::fs::read_to_string(file).expect("shipped")
}

pub(crate) fn machine() -> Machine {
    Machine::parse(&machine_file(), "five-axis.toml").expect("shipped")
}

pub(crate) fn guard() -> GuardSettings {
    let mut guard = GuardSettings::new(AxisSettings::new(Um(250.0), Um(500.0)));
    guard.rotary = Some(AxisSettings::new(Urad(250.0), Urad(500.0)));
    // The simulated control has no barrier.
    guard.without_barrier = WithoutBarrier { linear: Um(2000.0), rotary: Urad(2000.0) };
    guard
}

/// A control without a barrier, with read-back, these axes in steps of 1 µm, and positions without the correction.
pub(crate) fn without_barrier(device: &str, axes: &[AxisName]) -> Description {
    let axis = |&name: &AxisName| Axis {
        name,
        includes_correction: false,
        resolution: Displacement::Length(Mm(0.001)),
        largest: None,
    };
    Description {
        device: device.to_owned(),
        channel: "one".to_owned(),
        axes: axes.iter().map(axis).collect(),
        reads: Vec::new(),
        heartbeat: Heartbeat::Watched,
        barrier: false,
        tells_applied: true,
        shown: ShownStates::ALL,
        sees_other_gateways: true,
        shortest_cycle: Duration::from_millis(1),
    }
}

pub(crate) fn referenced(
    positions: PerChannel<f64>,
    taken: Instant,
    applied: Option<PerChannel<f64>>,
) -> Snapshot {
    Snapshot {
        positions,
        taken,
        state_taken: taken,
        correction_taken: taken,
        uncertainty: Duration::ZERO,
        state: ControllerState { referenced: true, ..ControllerState::default() },
        applied,
        report: None,
    }
}

/// A stationary control, with coordinates in mm and deg in the order of [`NAMES`].
pub(crate) fn control(place: [f64; 5], clock: &Clock) -> simulated::SimulatedController {
    control_of(&NAMES, &place, clock)
}

fn control_of(
    names: &[AxisName],
    coordinates: &[f64],
    clock: &Clock,
) -> simulated::SimulatedController {
    let mut to = PerChannel::ZERO;
    for ((to, name), at) in to.iter_mut().zip(names).zip(coordinates) {
        *to = Displacement::from_coordinate(name.kind(), *at).mm_or_rad();
    }
    let stands = simulated::Move { to, feed_per_s: 1.0, dwell: Duration::from_secs(3600) };
    simulated_control(names, vec![stands], clock)
}

pub(crate) fn simulated_control(
    names: &[AxisName],
    program: Vec<simulated::Move>,
    clock: &Clock,
) -> simulated::SimulatedController {
    let machine = simulated::Machine {
        axes: names
            .iter()
            .map(|&name| Axis {
                name,
                includes_correction: false,
                resolution: Displacement::new(name.kind(), 1e-8),
                largest: None,
            })
            .collect(),
        program,
        acceleration_per_s2: 1e6,
        sensors: Vec::new(),
        truth: Arc::new(|_, _| PerChannel::ZERO),
        clock: clock.clone(),
    };
    machine.start().0
}

/// A control of which only the first axes are written and the others read.
pub(crate) struct Writes<C> {
    inner: C,
    description: Description,
}

impl<C: Controller> Writes<C> {
    pub(crate) fn first(written: usize, inner: C) -> Self {
        let mut description = inner.description().clone();
        let others = description.axes.split_off(written);
        description.reads = others.iter().map(|axis| axis.name).collect();
        Self { inner, description }
    }
}

impl<C: Controller> Controller for Writes<C> {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        self.inner.read(deadline)
    }

    fn apply(&mut self, correction: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        let beyond = &correction[self.description.axes.len()..];
        assert!(beyond.iter().all(|x| *x == 0.0), "they are only read");
        self.inner.apply(correction, deadline)
    }
}

/// Faults that a test injects into a controller owned by a cycle.
#[derive(Clone, Default)]
pub(crate) struct Injected(Arc<Injections>);

#[derive(Default)]
struct Injections {
    silent: AtomicBool,
    stopped: AtomicBool,
    unreferenced: AtomicBool,
    /// Error of the first axis's reported position, mm or rad, as bits.
    displaced: AtomicU64,
}

impl Injected {
    pub(crate) fn disturb<C: Controller>(&self, inner: C) -> impl Controller + use<C> {
        Disturbed { inner, by: self.clone() }
    }

    pub(crate) fn set_silent(&self, silent: bool) {
        self.0.silent.store(silent, Ordering::Relaxed);
    }

    pub(crate) fn set_stopped(&self, stopped: bool) {
        self.0.stopped.store(stopped, Ordering::Relaxed);
    }

    pub(crate) fn set_unreferenced(&self, unreferenced: bool) {
        self.0.unreferenced.store(unreferenced, Ordering::Relaxed);
    }

    /// Sets the error of the first axis's reported position, mm or rad.
    pub(crate) fn displace(&self, by: f64) {
        self.0.displaced.store(by.to_bits(), Ordering::Relaxed);
    }
}

struct Disturbed<C> {
    inner: C,
    by: Injected,
}

impl<C: Controller> Controller for Disturbed<C> {
    fn description(&self) -> &Description {
        self.inner.description()
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        if self.by.0.silent.load(Ordering::Relaxed) {
            return Err(Fault::TimedOut);
        }
        let mut snapshot = self.inner.read(deadline)?;
        snapshot.positions[0] += f64::from_bits(self.by.0.displaced.load(Ordering::Relaxed));
        snapshot.state.emergency_stop |= self.by.0.stopped.load(Ordering::Relaxed);
        snapshot.state.referenced &= !self.by.0.unreferenced.load(Ordering::Relaxed);
        Ok(snapshot)
    }

    fn apply(&mut self, correction: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        self.inner.apply(correction, deadline)
    }
}

pub(crate) fn alone() -> PathSettings {
    PathSettings { watch: Duration::ZERO, ..PathSettings::default() }
}

pub(crate) fn path_of(
    control: impl Controller + 'static,
    model: &Model,
    guard: &GuardSettings,
    settings: &PathSettings,
) -> (ControlPath, Limits) {
    let described = control.description().clone();
    let plan = PathPlan::new(described, model, guard, settings, PERIOD).expect("fits");
    let path = ControlPath::new(Box::new(control), &plan).expect("fits");
    (path, plan.limits)
}

/// A cycle over these paths without thermometers.
pub(crate) fn cycle_of(
    model: Model,
    guard: &GuardSettings,
    paths: Vec<ControlPath>,
) -> Result<Cycle, PlanError> {
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    Cycle::new(Box::new(model), paths, guard.hand_back, sensors, PERIOD)
}

pub(crate) fn tip_mm(error: Option<ToolError>) -> f64 {
    Vector3::from(error.expect("positions are known").position_mm).norm()
}

pub(crate) fn step(cycle: &mut Cycle, clock: &Clock, request: Option<Request>) -> Report {
    clock.advance(PERIOD);
    run(cycle, clock, request)
}

pub(crate) fn run(cycle: &mut Cycle, clock: &Clock, request: Option<Request>) -> Report {
    let input = CycleInput { request, ..CycleInput::default() };
    cycle.run(clock.now(), &input, &mut || Duration::ZERO);
    *cycle.report()
}

pub(crate) struct Rig {
    pub(crate) cycle: Cycle,
    pub(crate) limits: Limits,
    pub(crate) clock: Clock,
}

impl Rig {
    pub(crate) fn at(place: [f64; 5]) -> Self {
        Self::writing(place, &NAMES)
    }

    pub(crate) fn injected(place: [f64; 5], by: &Injected) -> Self {
        Self::injected_of(&NAMES, &place, by)
    }

    pub(crate) fn injected_of(names: &[AxisName], coordinates: &[f64], by: &Injected) -> Self {
        let clock = Clock::manual();
        let control = by.disturb(control_of(names, coordinates, &clock));
        Self::on(&machine(), &guard(), control, clock)
    }

    /// A rig whose control writes only these axes and reports the positions of the others.
    pub(crate) fn writing(place: [f64; 5], names: &[AxisName]) -> Self {
        Self::of(&machine(), &guard(), place, names)
    }

    /// Like [`writing`](Self::writing), with another machine and other settings.
    pub(crate) fn of(
        machine: &Machine,
        guard: &GuardSettings,
        place: [f64; 5],
        names: &[AxisName],
    ) -> Self {
        let has = |name: &&AxisName| machine.index_of(**name).is_ok();
        let others = NAMES.iter().filter(|name| !names.contains(name));
        let all: Vec<AxisName> = names.iter().chain(others.filter(has)).copied().collect();
        let at = |name: &AxisName| NAMES.iter().zip(place).find(|(known, _)| *known == name);
        let coordinates: Vec<f64> =
            all.iter().map(|name| at(name).expect("one of the machine").1).collect();
        let clock = Clock::manual();
        let control = control_of(&all, &coordinates, &clock);
        Self::on(machine, guard, Writes::first(names.len(), control), clock)
    }

    /// A rig whose control writes all of these axes, at these coordinates (mm, deg).
    pub(crate) fn with(
        machine: &Machine,
        guard: &GuardSettings,
        names: &[AxisName],
        coordinates: &[f64],
    ) -> Self {
        let clock = Clock::manual();
        let control = control_of(names, coordinates, &clock);
        Self::on(machine, guard, control, clock)
    }

    fn on(
        machine: &Machine,
        guard: &GuardSettings,
        control: impl Controller + 'static,
        clock: Clock,
    ) -> Self {
        let model = Model::new(machine, guard.fading).expect("compiles");
        let (path, limits) = path_of(control, &model, guard, &alone());
        let cycle = cycle_of(model, guard, vec![path]).expect("one path");
        Self { cycle: cycle.with_start(clock.start()), clock, limits }
    }

    /// Arms after some readings, and runs for `cycles`.
    pub(crate) fn arm(&mut self, cycles: u32) -> Report {
        self.run(20);
        self.step(Some(Request::Arm));
        self.run(cycles)
    }

    /// Arms, and compensates for these cycles. Returns the last report, and the largest excess of the tip's residual over its error
    /// without correction, mm.
    pub(crate) fn arm_and_compare(&mut self, cycles: u32) -> (Report, f64) {
        self.run(20);
        self.step(Some(Request::Arm));
        let mut worst = f64::NEG_INFINITY;
        for _ in 0..cycles {
            let report = self.step(None);
            worst = worst.max(tip_mm(report.residual) - tip_mm(report.error));
        }
        let report = self.step(None);
        assert_eq!(report.state.name(), "compensating");
        (report, worst)
    }

    pub(crate) fn swap(&mut self, machine: &Machine) {
        let model = Model::new(machine, Fading::default()).expect("compiles");
        let mut replacement = Replacement::new(Box::new(model), &[]);
        let swapped = self.cycle.swap_model(&mut replacement);
        swapped.expect("the same axes");
    }

    pub(crate) fn step(&mut self, request: Option<Request>) -> Report {
        step(&mut self.cycle, &self.clock, request)
    }

    pub(crate) fn run(&mut self, cycles: u32) -> Report {
        (1..cycles).for_each(|_| {
            self.step(None);
        });
        self.step(None)
    }
}
