//! Two mailboxes of one barrier, used in turn and with faults: one path sends frames, the other path uses plain digital
//! lines. The test checks the axis itself.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use rand::{RngExt, SeedableRng};
use volcomp_digital_io::{Coherence, DigitalAxis, DigitalController, Panel, PositionWord, Wiring};
use volcomp_guard::{
    Request,
    barrier::{Program, Protection},
};
use volcomp_model::Machine;
use volcomp_port::{
    Axis, Clock, Controller, Description, Fault, Snapshot, Words,
    simulated::{self, Controls, Plant},
};
use volcomp_runtime::{
    AxisSettings, BarrierSettings, ControlPath, Cycle, CycleInput, GuardSettings, Model, PathPlan,
    PathSettings, Report, Sensors,
};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerChannel, Um};

use crate::bench::{PERIOD, Seen, Watched, unproven};

const SCAN: Duration = Duration::from_millis(2);
/// Barrier rate on X per scan, with rounding, mm.
const MOST: f64 = 0.002 + 1e-9;
const SECOND: Duration = Duration::from_secs(1);

const MACHINE: &str = "structure = \"w X' b Y Z t\"
axes = { X.travel = [0, 1000], Y.travel = [0, 1], Z.travel = [0, 1] }
errors = { EXX = { poly = [20] } }";

/// The digital lines of a control that reports the position of X.
struct Lines {
    inner: DigitalController<Panel>,
    panel: Panel,
    plant: Plant,
    clock: Clock,
    lost: Arc<Mutex<u32>>,
}

impl Controller for Lines {
    fn description(&self) -> &Description {
        self.inner.description()
    }

    fn read(&mut self, _: Instant) -> Result<Snapshot, Fault> {
        self.panel.shows(0, self.plant.commanded()[0]);
        let snapshot = self.inner.read(Instant::now() + SECOND)?;
        Ok(snapshot.at(self.clock.now()))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        let mut lost = self.lost.lock().expect("no panic");
        if *lost > 0 {
            *lost -= 1;
            return Err(Fault::Disconnected);
        }
        self.inner.apply(corrections, Instant::now() + SECOND)
    }

    fn post(&mut self, _: &Words, _: Instant) -> Result<(), Fault> {
        Err(Fault::Unsupported("frames"))
    }
}

struct Rig {
    cycle: Cycle,
    clock: Clock,
    controls: Arc<Controls>,
    frames: Arc<Mutex<Seen>>,
    lost: Arc<Mutex<u32>>,
}

fn rig() -> Rig {
    let clock = Clock::manual();
    let axis = Axis {
        name: AxisName::X,
        includes_correction: false,
        resolution: Displacement::Length(Mm(0.001)),
        largest: None,
    };
    let go =
        |x: f64| simulated::Move { to: PerChannel::leading([x]), feed_per_s: 100.0, dwell: SECOND };
    let machine = simulated::Machine {
        axes: vec![axis],
        program: vec![go(100.0), go(900.0)],
        acceleration_per_s2: 1000.0,
        sensors: Vec::new(),
        truth: Arc::new(|_, _| PerChannel::ZERO),
        clock: clock.clone(),
    };
    let protection = Protection::default();
    let settings = protection.settings(&machine.axes).expect("sensible");
    let program = Program::new(settings).expect("sensible");
    let (control, _, controls) = machine.start_with(Box::new(program), SCAN);
    let plant = control.plant();

    let wiring = Wiring { position: (0..20).collect(), latch: Some(8), ..Wiring::published() };
    let x = DigitalAxis {
        position: PositionWord {
            bits: 20,
            step: Displacement::Length(Mm(0.001)),
            ..PositionWord::PUBLISHED
        },
        ..DigitalAxis::published(AxisName::X)
    };
    let panel = Panel::new(wiring.clone(), vec![x]);
    let to = plant.clone();
    panel.on_write(move |word| {
        let counts = word.counts.and_then(|counts| i16::try_from(counts).ok());
        to.set_lines(word.latch, word.axis, counts.expect("8 bits"));
    });
    let channel = control.description().channel.clone();
    let inner = DigitalController::new(panel.clone(), channel, wiring, Coherence::Latched, vec![x]);
    let lost = Arc::new(Mutex::new(0));
    let lines = Lines {
        inner: inner.expect("fits"),
        panel,
        plant,
        clock: clock.clone(),
        lost: Arc::clone(&lost),
    };

    let mut guard = GuardSettings::new(AxisSettings::new(Um(100.0), Um(500.0)));
    guard.ramp = SECOND / 5;
    guard.hand_back = SECOND / 2;
    let model = Machine::parse(MACHINE, "m").expect("valid");
    let model = Model::new(&model, guard.fading).expect("compiles");
    let fixed = [AxisName::Y, AxisName::Z].map(|name| (name, Displacement::Length(Mm(0.0))));
    let settings = PathSettings { fixed: fixed.into(), unwatched: true, ..unproven() };
    let with_barrier = PathSettings {
        barrier: Some(BarrierSettings { machine: protection.machine, scan: SCAN }),
        ..settings.clone()
    };
    let frames = Arc::new(Mutex::new(Seen::default()));
    let path = |controller: Box<dyn Controller>, settings: &PathSettings| {
        let described = controller.description().clone();
        let plan = PathPlan::new(described, &model, &guard, settings, PERIOD).expect("fits");
        ControlPath::new(controller, &plan).expect("fits")
    };
    let paths = vec![
        path(Box::new(Watched::new(control, &frames)), &with_barrier),
        path(Box::new(lines), &settings),
    ];
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    let cycle = Cycle::new(Box::new(model.clone()), paths, guard.hand_back, sensors, PERIOD);
    Rig {
        cycle: cycle.expect("two paths").with_clock(clock.clone()),
        clock,
        controls,
        frames,
        lost,
    }
}

impl Rig {
    fn run(&mut self, time: Duration, request: Option<Request>) -> Report {
        let end = self.clock.elapsed() + time;
        let mut asked = CycleInput { request, ..CycleInput::default() };
        while self.clock.elapsed() < end {
            self.clock.advance(PERIOD);
            self.cycle.run(self.clock.now(), &asked, &mut || Duration::ZERO);
            asked.request = None;
            let largest = self.controls.axes.largest_change()[0];
            assert!(largest <= MOST, "{largest} mm at {:?}", self.clock.elapsed());
        }
        *self.cycle.report()
    }

    fn cut(&self, is_cut: bool) {
        self.frames.lock().expect("no panic").fault = is_cut.then_some(Fault::TimedOut);
    }

    /// Checks that the path with this index is active and X has its full correction.
    fn corrects(&self, report: &Report, active: usize) {
        let got = (report.state.name(), report.active);
        assert_eq!(got, ("compensating", active), "{:?}", report.reasons);
        let x = self.controls.axes.applied()[0];
        assert!((x + 0.020).abs() < 1e-9, "{x} mm by path {active}");
    }
}

#[test]
fn frames_and_lines_correct_in_turn() {
    let mut rig = rig();
    rig.run(2 * SECOND, None);
    let report = rig.run(2 * SECOND, Some(Request::Arm));
    rig.corrects(&report, 0);
    for _ in 0..3 {
        // The frames end. The lines wait until the barrier is free, start at zero, and apply the correction.
        rig.cut(true);
        let report = rig.run(SECOND / 5, None);
        assert_eq!(report.active, 0, "the barrier may still apply it");
        let report = rig.run(3 * SECOND, None);
        rig.corrects(&report, 1);
        // The frames return, and take over from the correction that the lines have applied.
        rig.cut(false);
        let report = rig.run(2 * SECOND, None);
        rig.corrects(&report, 0);
    }
}

#[test]
fn frames_and_lines_in_turn_at_any_moment_with_writes_that_fail() {
    for seed in 0..20 {
        let mut rng = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let mut rig = rig();
        rig.run(2 * SECOND, None);
        rig.run(SECOND / 10, Some(Request::Arm));
        for turn in 0..12 {
            rig.cut(turn % 2 == 0);
            *rig.lost.lock().expect("no panic") = rng.random_range(0..60);
            rig.run(Duration::from_millis(rng.random_range(4..1500)), None);
        }
        *rig.lost.lock().expect("no panic") = 0;
        rig.cut(false);
        let report = rig.run(5 * SECOND, None);
        rig.corrects(&report, 0);
    }
}
