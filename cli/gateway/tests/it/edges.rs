//! The gateway program and a control with a barrier, end to end. Whatever happens to the program, an axis never moves
//! by more than the barrier's rate in one scan; without a barrier it would make the whole change in one step. The
//! rehearsal covers faults of the connection and of the control (`with_a_barrier_no_fault_is_excepted`).
//!
//! Each test repeats a few times, or `VOLCOMP_REPEATS` times.

use std::{
    path::Path,
    sync::Arc,
    thread::sleep,
    time::{Duration, Instant},
};

use volcomp_focas::simulator::{Options, Simulator, World};
use volcomp_guard::{Reasons, Request, barrier::Program as Barrier};
use volcomp_runtime::CycleInput;
use volcomp_vocabulary::AxisName;

use crate::{
    controlled::configuration,
    manual::machine,
    online::check,
    program::{Program, change, path},
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
    let config = configuration(dir, control, "auto_arm = true");
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
    for _ in 0..2000 {
        if control.world().shift_counts()[1] == -20 {
            return;
        }
        sleep(Duration::from_millis(5));
    }
    panic!("{:?}: {}", control.world().shift_counts(), program.state());
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
        let held = control.world().shifts();
        program.signal("CONT");
        assert_eq!(held, [0.0; 3], "the control ramps to zero");
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
