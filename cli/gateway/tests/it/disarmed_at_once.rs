//! A person disarms while an order to arm, given just before, is about to be answered.

use std::{sync::Arc, time::Duration};

use volcomp_focas::simulator::{Options, Simulator, World};

use crate::{
    controlled::configuration,
    program::{Program, change, path},
    standing::kept,
};

/// The control thread is in the middle of an exchange when it is disarmed: the service still sees the state of before, takes the
/// arming as done, and forgets who disarmed it after that.
#[test]
fn a_persons_disarming_right_after_arming_outlives_a_restart() {
    let dir = tempfile::tempdir().expect("writable");
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|_| vec![400.0, 150.0, 50.0]);
    let options = Options {
        latency: Duration::from_millis(12),
        ..Options::default()
    };
    let control = Simulator::start("127.0.0.1:0", options, world).expect("loopback");
    let config = configuration(dir.path(), &control, "auto_arm = true");
    change(&config, "cycle_ms = 4.0", "cycle_ms = 100.0");
    let arguments = ["--config", path(&config)];
    let mut program = Program::start(dir.path(), &arguments);
    program.wait_for("compensating");
    assert_eq!(program.post("/api/disarm", "").status, 200);
    program.wait_for("disarmed");
    let standing = dir.path().join("audit/standing.slots");
    let mut lost = None;
    for delay_ms in (200..=300).step_by(20) {
        let delay = Duration::from_millis(delay_ms);
        let disarmed = std::thread::scope(|scope| {
            let arms = scope.spawn(|| program.arm());
            std::thread::sleep(delay);
            let disarmed = program.post("/api/disarm", "");
            arms.join().expect("answers");
            disarmed
        });
        std::thread::sleep(Duration::from_millis(400));
        let state = program.state();
        let text = kept(&standing);
        if state["state"] != "disarmed" && state["state"] != "ramping-out" {
            program.post("/api/disarm", "");
        } else if disarmed.status == 200 && !text.contains("\"disarmed_by\":\"") {
            lost = Some(delay_ms);
            break;
        }
        program.wait_for("disarmed");
    }
    program.wait_for("disarmed");
    program.running.kill();
    drop(program);
    let text = kept(&standing);
    let program = Program::start(dir.path(), &arguments);
    std::thread::sleep(Duration::from_secs(4));
    let state = program.state();
    assert_eq!(
        state["state"], "disarmed",
        "disarmed {lost:?} ms after arming; it was written down: {text}"
    );
}
