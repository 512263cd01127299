//! Motion of an axis when a program or a path to the control fails, with and without a barrier.
//!
//! Whatever happens to the program, an axis never moves by more than the barrier's rate in one scan; without a barrier
//! it would make the whole change in one step. The rehearsal covers faults of the connection and of the control
//! (`with_a_barrier_no_fault_is_excepted`).
//!
//! With two paths to one machine, and with the stored state of the previous run, an axis must not step when a path
//! stops responding, reports less than the other path, or was changed in between. Two mailboxes of one barrier are used
//! in turn: one path sends frames, the other path uses plain digital lines.
//!
//! The tests of the program repeat a few times, or `VOLCOMP_REPEATS` times.

use std::{
    path::Path,
    sync::{Arc, Mutex},
    thread::sleep,
    time::{Duration, Instant},
};

use rand::{RngExt, SeedableRng};
use volcomp_digital_io::{Coherence, DigitalAxis, DigitalController, Panel, PositionWord, Wiring};
use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_gateway::simulate::{self, Simulation, protection};
use volcomp_guard::{
    Reasons, Request,
    barrier::{Program as Barrier, Protection},
};
use volcomp_model::Machine;
use volcomp_port::{
    Axis, Clock, Controller, Description, Fault, Snapshot, Words,
    inject::{Faults, Faulty, Injection},
    simulated::{self, Controls, Plant},
};
use volcomp_runtime::{
    AxisSettings, BarrierSettings, ControlPath, Cycle, CycleInput, GuardSettings, Model, PathPlan,
    PathSettings, Report, Sensors,
};
use volcomp_test_support::until;
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerAxis, PerChannel, Um};

use crate::{
    bench::{self, Bench, PERIOD, Seen, Watched, cycle, unproven},
    check::check,
    manual::{controlled_configuration, machine},
    program::{PATIENCE, Program, change, path},
};

/// Rate of the barrier: counts of 1 µm per scan of 2 ms.
const RATE: i64 = 2;
fn repeats() -> u64 {
    let asked = std::env::var("VOLCOMP_REPEATS");
    asked.ok().and_then(|asked| asked.parse().ok()).unwrap_or(3)
}

/// A pseudo-random duration below `most_ms`, determined by `number`.
fn some(number: u64, most_ms: u64) -> Duration {
    let mixed = number
        .wrapping_add(1)
        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
        .rotate_left(31)
        .wrapping_mul(0xbf58_476d_1ce4_e5b9);
    Duration::from_millis((mixed >> 33) % most_ms)
}

/// A control whose X moves back and forth, not started yet. Limit 150 counts, rate 2 counts per scan of 2 ms.
pub(crate) fn world() -> World {
    let axes = [AxisName::X, AxisName::Y, AxisName::Z];
    let settings = volcomp_test_support::barrier::settings(&axes).expect("sensible");
    let barrier = Barrier::new(settings).expect("sensible");
    let mut world = World::new(&['X', 'Y', 'Z']).with_barrier(Box::new(barrier));
    world.motion = Arc::new(|elapsed| {
        let x = 400.0 + 300.0 * (elapsed.as_secs_f64() * 0.5).sin();
        vec![x, 150.0, 50.0]
    });
    world
}

pub(crate) fn start(world: World) -> Simulator {
    Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback")
}

pub(crate) fn guarded(dir: &Path, control: &Simulator) -> std::path::PathBuf {
    let config = controlled_configuration(dir, control, "auto_arm = true");
    change(
        &config,
        "heartbeat = { pmc = \"R\", at = 120 }",
        "barrier = { machine = 4711, scan_ms = 2.0, frame = { pmc = \"R\", at = 200 }, report = { pmc = \"R\", at = 240 } }",
    );
    config
}

/// Waits until the gateway compensates and the axes have their correction, −20 µm on Y.
fn corrects(program: &Program, control: &Simulator) {
    program.wait_for("compensating");
    until("Y has its correction", PATIENCE, || control.world().shift_counts()[1] == -20);
}

fn no_step(control: &Simulator, of: &str) {
    let world = control.world();
    let steps = world.largest_steps();
    assert!(steps.iter().all(|step| *step <= RATE), "{of}: {steps:?}");
}

/// The gateway is stopped for two seconds at any moment, even between reading and writing, or killed at any moment and
/// started again. No axis steps, whether the control meanwhile holds the correction, ramps it out, or is at zero.
#[test]
fn stopped_or_killed_at_any_moment_no_axis_steps() {
    let dir = tempfile::tempdir().expect("writable");
    let control = start(world());
    let config = guarded(dir.path(), &control);
    let arguments = ["--config", path(&config)];
    let mut program = Program::start(dir.path(), &arguments);
    for number in 0..repeats() {
        corrects(&program, &control);
        sleep(some(number, 300));
        program.signal("STOP");
        sleep(Duration::from_secs(2));
        until("the control ramps to zero", PATIENCE, || control.world().shifts() == [0.0; 3]);
        program.signal("CONT");
        corrects(&program, &control);
        no_step(&control, &format!("stopped, {number}"));
        sleep(some(number, 700));
        program.running.kill();
        sleep(some(number + 1000, 1500));
        no_step(&control, &format!("killed, {number}"));
        program = Program::start(dir.path(), &arguments);
    }
    corrects(&program, &control);
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    assert_eq!(control.world().shifts(), [0.0; 3], "ramped out");
    no_step(&control, "ended");
}

/// The barrier has the axes in the order X, Y, Z and the configuration in another order. The gateway stays disarmed,
/// because X would get the correction of Y, and `check --online` fails.
#[test]
fn axes_in_another_order_than_the_barriers_are_refused() {
    let dir = tempfile::tempdir().expect("writable");
    let control = start(world());
    let config = guarded(dir.path(), &control);
    change(&config, r#"axes = ["X", "Y", "Z"]"#, r#"axes = ["Y", "X", "Z"]"#);
    let (_, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 1, "{errors}");
    assert!(
        errors.contains("found no report of a barrier for this machine and these axes")
            && errors.contains("the axes YXZ in this order")
            && errors.contains("`layout` to 213"),
        "{errors}"
    );
    let plan = machine(&config).plan().expect("right");
    let mut cycle = plan.open().expect("it listens").cycle;
    let arm = CycleInput { request: Some(Request::Arm), ..CycleInput::default() };
    for _ in 0..200 {
        cycle.run(Instant::now(), &arm, &mut || Duration::ZERO);
        sleep(Duration::from_millis(4));
    }
    let report = cycle.report();
    assert!(report.reasons.contains(Reasons::BARRIER_STRANGE));
    let state = (report.state.name(), report.correction_known);
    assert_eq!(state, ("disarmed", false), "{:?}", report.reasons);
    assert_eq!(control.world().shift_counts(), [0, 0, 0]);
    drop(cycle);
    change(&config, r#"axes = ["Y", "X", "Z"]"#, r#"axes = ["X", "Y", "Z"]"#);
    // On a busy computer the simulated control may count too few scans, which is another error.
    let (_, errors, _) = check(&config, &["--online"]);
    assert!(!errors.contains("found no report of a barrier"), "{errors}");
}

const SECOND: Duration = Duration::from_secs(1);
/// Maximum change per cycle, mm: the guard's slew, or the barrier's rate per scan, with rounding.
const MOST: f64 = 0.002 + 1e-9;

/// Two paths to one machine. If `blind` is set, the second path never reports an interlock.
fn two_ways(barrier: bool, blind: bool) -> Bench {
    let clock = Clock::manual();
    let guard = simulate::guard();
    let simulation = if barrier {
        Simulation::with_barrier(clock.clone())
    } else {
        Simulation::new(clock.clone())
    };
    let simulation = simulation.expect("built in");
    let protection = protection();
    let settings = PathSettings {
        barrier: barrier
            .then_some(BarrierSettings { machine: protection.machine, scan: protection.scan }),
        ..unproven()
    };
    let model = Model::new(&simulation.model, guard.fading).expect("built in");
    let another = simulation.controller.another().expect("few ways");
    let mut another = Faulty::new(another, Faults::default(), 1);
    if blind {
        another.inject(Injection::DroppedFlag { readings: u32::MAX });
    }
    let seen = Arc::new(Mutex::new(Seen::default()));
    let first = Watched::new(simulation.controller, &seen);
    let paths = vec![
        bench::path(first, &model, &guard, &settings),
        bench::path(another, &model, &guard, &settings),
    ];
    let thermometer = Box::new(simulation.thermometer);
    let mut bench = Bench {
        cycle: cycle(model, paths, &guard, thermometer, &clock),
        clock,
        controls: simulation.controls,
        truth: simulation.truth,
        seen,
        forbids: Reasons::NONE,
    };
    // A barrier needs a second for counting its scans; plain values need three readings.
    bench.run(2 * SECOND);
    bench
}

fn armed(mut bench: Bench) -> Bench {
    bench.request(Request::Arm);
    let report = bench.run(2 * SECOND);
    assert_eq!(report.state.name(), "compensating", "{:?}", report.reasons);
    bench
}

fn largest_change(bench: &Bench) -> f64 {
    let changes = bench.controls.axes.largest_change();
    changes.iter().copied().fold(0.0, f64::max)
}

fn silence_first(bench: &Bench, fault: Option<Fault>) {
    bench.seen.lock().expect("no panic").fault = fault;
}

/// The stored correction is 40 µm, but the control reports 0. The gateway shows 0 as applied, and its first write makes
/// no step.
#[test]
fn the_reported_correction_replaces_the_remembered_one() {
    for barrier in [false, true] {
        let mut bench = two_ways(barrier, false);
        let remembered = PerAxis::from_fn(|axis| if axis == 1 { -0.040 } else { 0.0 });
        bench.cycle.restore(&remembered, Duration::ZERO);
        let report = bench.run(SECOND);
        assert_eq!(report.correction[1].abs(), 0.0, "barrier: {barrier}");
        let bench = armed(bench);
        assert!(largest_change(&bench) <= MOST, "{}", largest_change(&bench));
    }
}

/// The first path reports an emergency stop and then stops responding. The second path cannot read the stop, so it must
/// not take over. No axis moves.
#[test]
fn an_emergency_stop_causes_no_change_of_path() {
    use std::sync::atomic::Ordering;
    for barrier in [false, true] {
        let mut bench = armed(two_ways(barrier, true));
        bench.controls.emergency_stop.store(true, Ordering::Relaxed);
        bench.run(SECOND);
        silence_first(&bench, Some(Fault::NotConnected));
        let report = bench.run(3 * SECOND);
        assert!(
            report.reasons.contains(Reasons::EMERGENCY_STOP | Reasons::INTERLOCK_UNSEEN),
            "{:?}",
            report.reasons
        );
        silence_first(&bench, None);
        bench.run(6 * SECOND);
        assert_eq!(bench.controls.axes.changes_while_held(), 0, "barrier {barrier}");
        bench.controls.emergency_stop.store(false, Ordering::Relaxed);
        let report = bench.run(4 * SECOND);
        assert_eq!(report.state.name(), "compensating", "{:?}", report.reasons);
        assert!(largest_change(&bench) <= MOST, "{}", largest_change(&bench));
    }
}

const SCAN: Duration = Duration::from_millis(2);

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
    let program = Barrier::new(settings).expect("sensible");
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
