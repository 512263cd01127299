//! Some ways to one control, which a test models: what it says on each way, and what it does with what is written.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use volcomp_model::Machine;
use volcomp_port::{Clock, Controller, Description, Fault, Snapshot, Words};
use volcomp_runtime::{
    ControlPath, Cycle, GuardSettings, Model, PathPlan, PathSettings, PlanError, Report,
    guard::{
        Request,
        barrier::{Barrier, Settings},
        protocol::{Counts, Layout},
    },
};
use volcomp_vocabulary::{AxisName, MAX_AXES, PerChannel};

use crate::rig::{self, PERIOD};

pub(crate) const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

/// A machine of three linear axes with these errors, compiled.
pub(crate) fn three_axes(errors: &str, guard: &GuardSettings) -> Model {
    let text = format!(
        "structure = \"w X' Y' b Z t\"
axes = {{ X.travel = [0, 100], Y.travel = [0, 500], Z.travel = [0, 400] }}
errors = {{ {errors} }}"
    );
    let machine = Machine::parse(&text, "m").expect("valid");
    Model::new(&machine, guard.fading).expect("compiles")
}

/// The barrier of a control of three axes: 150 counts, 2 counts a scan.
pub(crate) fn barrier_of_three_axes(hold_scans: u16, time_out_scans: u16) -> Barrier {
    let settings = Settings {
        axes: Layout::of(AXES).expect("each once"),
        machine: 1,
        limit: PerChannel([150; MAX_AXES]),
        rate: PerChannel([2; MAX_AXES]),
        step_scans: 1,
        hold_scans,
        time_out_scans,
    };
    Barrier::start(settings, 1, 0, &Counts::default()).expect("good settings")
}

/// The control of a test.
pub(crate) trait Plant: Send {
    /// What it says on this way.
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault>;

    /// Takes plain values on this way.
    fn apply(
        &mut self,
        way: &Description,
        corrections: &PerChannel<f64>,
        clock: &Clock,
    ) -> Result<(), Fault>;

    /// Takes a frame on this way.
    fn post(&mut self, _: &Description, _: &Words) -> Result<(), Fault> {
        Err(Fault::Unsupported("frames"))
    }

    /// For how long a reading on this way keeps whoever asks.
    fn hangs(&self, _: &Description) -> Duration {
        Duration::ZERO
    }
}

/// The control, and the clock of the test.
pub(crate) struct Ways<P> {
    plant: Arc<Mutex<P>>,
    pub(crate) clock: Clock,
}

impl<P: Plant + 'static> Ways<P> {
    pub(crate) fn to(plant: P, clock: Clock) -> Self {
        Self {
            plant: Arc::new(Mutex::new(plant)),
            clock,
        }
    }

    pub(crate) fn plant(&self) -> MutexGuard<'_, P> {
        self.plant.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A way that the driver describes so, as a controller.
    pub(crate) fn controller(&self, description: Description) -> Box<dyn Controller> {
        Box::new(Way {
            plant: Arc::clone(&self.plant),
            clock: self.clock.clone(),
            description,
        })
    }

    /// The same as a path of a cycle.
    pub(crate) fn path(
        &self,
        description: Description,
        model: &Model,
        guard: &GuardSettings,
        settings: &PathSettings,
    ) -> ControlPath {
        let plan = PathPlan::new(description.clone(), model, guard, settings, PERIOD);
        ControlPath::new(self.controller(description), &plan.expect("fits")).expect("fits")
    }

    /// A cycle over some of its ways, by the clock of the test.
    pub(crate) fn cycle(
        &self,
        model: Model,
        guard: &GuardSettings,
        paths: Vec<ControlPath>,
    ) -> Result<Cycle, PlanError> {
        Ok(rig::cycle_of(model, guard, paths)?.with_clock(self.clock.clone()))
    }

    /// One cycle at the present time of the clock.
    pub(crate) fn run(&self, cycle: &mut Cycle, request: Option<Request>) -> Report {
        rig::run(cycle, &self.clock, request)
    }

    /// One cycle, a period after the last.
    pub(crate) fn step(&self, cycle: &mut Cycle, request: Option<Request>) -> Report {
        rig::step(cycle, &self.clock, request)
    }
}

struct Way<P> {
    plant: Arc<Mutex<P>>,
    clock: Clock,
    description: Description,
}

impl<P: Plant> Way<P> {
    fn plant(&self) -> MutexGuard<'_, P> {
        self.plant.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<P: Plant> Controller for Way<P> {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _: Instant) -> Result<Snapshot, Fault> {
        let (read, hangs) = {
            let mut plant = self.plant();
            let read = plant.read(&self.description, &self.clock);
            (read, plant.hangs(&self.description))
        };
        std::thread::sleep(hangs);
        read
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        self.plant()
            .apply(&self.description, corrections, &self.clock)
    }

    fn post(&mut self, frame: &Words, _: Instant) -> Result<(), Fault> {
        self.plant().post(&self.description, frame)
    }
}
