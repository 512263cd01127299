//! What keeps a gateway from arming, or from arming by itself.

use std::time::Duration;

use crate::{
    controlled::{configuration, control},
    program::{Program, change, path},
};

/// Axes that never stand still keep the test shift waiting; a person who disarms then is not overruled by auto_arm.
#[test]
fn auto_arm_does_not_overrule_a_person() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    change(&config, "test_shift_um = 0", "test_shift_um = 5");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let state = program.wait_for("arming");
    assert!(
        state["reasons"]
            .to_string()
            .contains("waiting for standstill"),
        "{state}"
    );
    assert_eq!(program.post("/api/disarm", "").status, 200);
    program.wait_for("disarmed");
    std::thread::sleep(Duration::from_millis(2500));
    assert_eq!(program.state()["state"], "disarmed");
    assert_eq!(control.world().shifts(), [0.0; 3]);
}

/// Without [guard] it runs and shows, and does not arm.
#[test]
fn without_limits_it_does_not_arm() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "auto_arm = true");
    let text = std::fs::read_to_string(&config).expect("readable");
    let (before, rest) = text.split_once("[guard]").expect("there");
    let (_, after) = rest.split_once("[[controller]]").expect("there");
    std::fs::write(&config, format!("{before}[[controller]]{after}")).expect("writable");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    program
        .wait(|state| state["positions_mm"]["Y"] == 150.0)
        .expect("it shows");
    let refused = program.post("/api/arm", "");
    assert_eq!(refused.status, 409);
    assert!(
        refused.body.contains("limits are not configured"),
        "{}",
        refused.body
    );
    assert_eq!(program.state()["state"], "disarmed");
}
