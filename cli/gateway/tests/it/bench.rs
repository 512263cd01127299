//! A cycle on a simulated machine with simulated time.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use assert_no_alloc::assert_no_alloc;
use volcomp_gateway::simulate::{self, Simulation, Truth};
use volcomp_guard::{Reasons, Request};
use volcomp_port::{
    Clock, Controller, Description, Fault, Snapshot, Thermometer, Words,
    simulated::{Controls, SimulatedController},
};

use volcomp_runtime::{
    ControlPath, Cycle, CycleInput, GuardSettings, Model, PathPlan, PathSettings, Report, Sensors,
};
use volcomp_vocabulary::PerChannel;

pub(crate) const PERIOD: Duration = Duration::from_millis(4);

/// A controller whose writes a test can observe and corrupt while the cycle owns the controller.
pub(crate) struct Watched<C> {
    inner: C,
    description: Description,
    seen: Arc<Mutex<Seen>>,
}

impl<C: Controller> Watched<C> {
    pub(crate) fn new(inner: C, seen: &Arc<Mutex<Seen>>) -> Self {
        Self { description: inner.description().clone(), inner, seen: Arc::clone(seen) }
    }

    pub(crate) fn on(mut self, channel: &str) -> Self {
        channel.clone_into(&mut self.description.channel);
        self
    }
}

/// Observed writes, and faults that a test injects.
#[derive(Default)]
pub(crate) struct Seen {
    pub(crate) applied: PerChannel<f64>,
    pub(crate) writes: u64,
    /// Offset that is added to the positions that the controller reports.
    pub(crate) offset: PerChannel<f64>,
    pub(crate) fault: Option<Fault>,
    /// True if writes are lost.
    pub(crate) deaf: bool,
}

impl<C: Controller> Controller for Watched<C> {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        let mut snapshot = self.inner.read(deadline)?;
        let seen = self.seen.lock().expect("no test holds it in a panic");
        if let Some(fault) = seen.fault {
            return Err(fault);
        }
        for (position, offset) in snapshot.positions.iter_mut().zip(&seen.offset) {
            *position += offset;
        }
        Ok(snapshot)
    }

    fn post(&mut self, frame: &Words, deadline: Instant) -> Result<(), Fault> {
        let mut seen = self.seen.lock().expect("no test holds it in a panic");
        seen.writes += 1;
        if seen.deaf {
            return Ok(());
        }
        self.inner.post(frame, deadline)
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        let mut seen = self.seen.lock().expect("no test holds it in a panic");
        seen.writes += 1;
        if seen.deaf {
            return Ok(());
        }
        seen.applied = *corrections;
        self.inner.apply(corrections, deadline)
    }
}

pub(crate) struct Bench {
    pub(crate) cycle: Cycle,
    pub(crate) clock: Clock,
    pub(crate) controls: Arc<Controls>,
    pub(crate) truth: Truth,
    pub(crate) seen: Arc<Mutex<Seen>>,
    pub(crate) forbids: Reasons,
}

pub(crate) struct Parts<'a> {
    pub(crate) controller: SimulatedController,
    pub(crate) model: &'a Model,
    pub(crate) seen: &'a Arc<Mutex<Seen>>,
    pub(crate) clock: &'a Clock,
}

pub(crate) fn path(
    controller: impl Controller + 'static,
    model: &Model,
    guard: &GuardSettings,
    settings: &PathSettings,
) -> ControlPath {
    let described = controller.description().clone();
    let plan =
        PathPlan::new(described, model, guard, settings, PERIOD).unwrap_or_else(|e| panic!("{e}"));
    ControlPath::new(Box::new(controller), &plan).unwrap_or_else(|e| panic!("{e}"))
}

/// Settings for a control that no other gateway can reach.
pub(crate) fn alone() -> PathSettings {
    PathSettings { watch: Duration::ZERO, ..PathSettings::default() }
}

pub(crate) fn unproven() -> PathSettings {
    PathSettings { proves: false, ..alone() }
}

impl Bench {
    pub(crate) fn with(
        guard: &GuardSettings,
        thermometer: impl FnOnce(Box<dyn Thermometer>) -> Box<dyn Thermometer>,
    ) -> Self {
        let proven = alone();
        let watched = |parts: Parts| {
            let controller = Watched::new(parts.controller, parts.seen);
            vec![path(controller, parts.model, guard, &proven)]
        };
        Self::of(guard, watched, thermometer)
    }

    /// The built-in simulation with other paths to its controller.
    pub(crate) fn through(
        guard: &GuardSettings,
        paths: impl FnOnce(Parts) -> Vec<ControlPath>,
    ) -> Self {
        Self::of(guard, paths, |thermometer| thermometer)
    }

    fn of(
        guard: &GuardSettings,
        paths: impl FnOnce(Parts) -> Vec<ControlPath>,
        thermometer: impl FnOnce(Box<dyn Thermometer>) -> Box<dyn Thermometer>,
    ) -> Self {
        let clock = Clock::manual();
        let simulation = Simulation::new(clock.clone()).expect("built in");
        let seen = Arc::new(Mutex::new(Seen::default()));
        let model = Model::new(&simulation.model, guard.fading).expect("built in");
        let paths = paths(Parts {
            controller: simulation.controller,
            model: &model,
            seen: &seen,
            clock: &clock,
        });
        Self {
            cycle: cycle(
                model,
                paths,
                guard,
                thermometer(Box::new(simulation.thermometer)),
                &clock,
            ),
            clock,
            controls: simulation.controls,
            truth: simulation.truth,
            seen,
            forbids: Reasons::NONE,
        }
    }

    pub(crate) fn new() -> Self {
        Self::with(&simulate::guard(), |thermometer| thermometer)
    }

    /// A bench that is armed and has completed the ramp.
    pub(crate) fn compensating() -> Self {
        let mut bench = Self::new();
        bench.run(Duration::from_millis(100));
        bench.request(Request::Arm);
        // The program starts with a dwell of 1.5 s at the first corner, which is longer than the test shift takes. Then
        // the correction ramps in.
        let report = bench.run(Duration::from_secs(2));
        assert_eq!(report.state.name(), "compensating");
        bench
    }

    /// Runs one cycle. Fails if the cycle allocates memory.
    pub(crate) fn step(&mut self, dt: Duration, request: Option<Request>) -> Report {
        self.clock.advance(dt);
        let asked = CycleInput { request, forbids: self.forbids, notes: Reasons::NONE };
        let now = self.clock.now();
        assert_no_alloc(|| {
            self.cycle.run(now, &asked, &mut || Duration::ZERO);
        });
        *self.cycle.report()
    }

    pub(crate) fn request(&mut self, request: Request) -> Report {
        self.step(PERIOD, Some(request))
    }

    pub(crate) fn run(&mut self, time: Duration) -> Report {
        let end = self.clock.elapsed() + time;
        let mut report = self.step(PERIOD, None);
        while self.clock.elapsed() < end {
            report = self.step(PERIOD, None);
        }
        report
    }

    pub(crate) fn applied(&self) -> PerChannel<f64> {
        self.seen.lock().expect("no test holds it in a panic").applied
    }

    /// Runs for `time`, and returns the largest change of a correction between two cycles, mm.
    pub(crate) fn largest_step(&mut self, time: Duration) -> f64 {
        let end = self.clock.elapsed() + time;
        let (mut before, mut largest) = (self.applied(), 0.0_f64);
        while self.clock.elapsed() < end {
            self.step(PERIOD, None);
            let now = self.applied();
            let changes = now.iter().zip(&before).map(|(a, b)| (a - b).abs());
            largest = changes.fold(largest, f64::max);
            before = now;
        }
        largest
    }
}

pub(crate) fn cycle(
    model: Model,
    paths: Vec<ControlPath>,
    guard: &GuardSettings,
    thermometer: Box<dyn Thermometer>,
    clock: &Clock,
) -> Cycle {
    let sensors = Sensors::new(vec![thermometer], guard.temperatures);
    Cycle::new(Box::new(model), paths, guard.hand_back, sensors, PERIOD)
        .unwrap_or_else(|e| panic!("{e}"))
        .with_start(clock.start())
}
