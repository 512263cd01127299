//! Every request in every state: what answers 200 has taken effect, what has not answers 409 and says why; disarming
//! and ending work in every state.

use std::{path::Path, sync::Arc, time::Duration};

use volcomp_focas::simulator::{Options, Simulator, World};

use crate::{
    controlled::configuration,
    program::{Program, change, path},
};

/// A state of the gateway, and what brings it about.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Setting {
    Disarmed,
    Arming,
    Compensating,
    HoldingInAnAlarm,
    RampingOut,
    RampingOutInAnAlarm,
    Faulted,
}

use Setting::{
    Arming, Compensating, Disarmed, Faulted, HoldingInAnAlarm, RampingOut, RampingOutInAnAlarm,
};

/// Each setting with the statuses of arm, disarm and acknowledge: 409 where there is nothing to acknowledge.
const TABLE: [(Setting, [u16; 3]); 7] = [
    (Disarmed, [200, 200, 409]),
    (Arming, [200, 200, 409]),
    (Compensating, [200, 200, 409]),
    // It is armed and goes on by itself. An alarm ends at the control.
    (HoldingInAnAlarm, [200, 200, 409]),
    (RampingOut, [200, 200, 409]),
    (RampingOutInAnAlarm, [409, 200, 409]),
    (Faulted, [409, 200, 200]),
];

fn alarm(control: &Simulator) {
    control.world().alarms.push((1, "ALARM".to_owned()));
}

/// A gateway in this state, and its control.
fn gateway(setting: Setting, dir: &Path) -> (Simulator, Program) {
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(move |elapsed| {
        // Where the axes move the test shift waits.
        let moves = if setting == Arming { 1.0 } else { 0.0 };
        let seconds = elapsed.as_secs_f64();
        // Only the position of an axis that moves shows that it does not contain the correction.
        let goes_on = if setting == Faulted {
            (seconds / 3.0).floor()
        } else {
            0.0
        };
        let x = 400.0 + goes_on + moves * 100.0 * seconds.sin();
        vec![x, 150.0, 50.0]
    });
    let control = Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback");
    let config = configuration(dir, &control, "");
    change(&config, "[guard]", "[guard]\nstop_s = 1");
    match setting {
        Arming => change(&config, "test_shift_um = 0", "test_shift_um = 5"),
        Faulted => {
            change(&config, "test_shift_um = 0", "test_shift_um = 5");
            change(&config, "axes =", "includes_correction = true\naxes =");
        }
        RampingOut | RampingOutInAnAlarm => change(&config, "ramp_s = 0.1", "ramp_s = 20"),
        Disarmed | Compensating | HoldingInAnAlarm => {}
    }
    let program = Program::start(dir, &["--config", path(&config)]);
    program
        .wait(|state| state["error_um"].is_array())
        .expect("it sees the machine");
    if setting == Faulted {
        program
            .wait(|state| state["positions_mm"]["X"].as_f64() > Some(400.9))
            .expect("X moves");
    }
    if setting == Disarmed {
        program.watch();
        return (control, program);
    }
    program.must_arm();
    match setting {
        Disarmed | Arming => {}
        Compensating => drop(program.wait_for("compensating")),
        HoldingInAnAlarm => {
            program.wait_for("compensating");
            alarm(&control);
            program.wait_for("holding");
        }
        RampingOut | RampingOutInAnAlarm => {
            program
                .wait(|state| {
                    state["correction_um"]["X"]
                        .as_f64()
                        .is_some_and(|um| um < -1.0)
                })
                .expect("it ramps in");
            assert_eq!(program.post("/api/disarm", "").status, 200);
            if setting == RampingOutInAnAlarm {
                alarm(&control);
                let seen = |reasons: &serde_json::Value| reasons.to_string().contains("alarm");
                program
                    .wait(|state| seen(&state["reasons"]))
                    .expect("it sees the alarm");
            }
            program.wait_for("ramping-out");
        }
        Faulted => {
            program.wait_for("faulted");
            program
                .wait(|state| state["correction_um"]["X"].as_f64() == Some(0.0))
                .expect("it ramps out");
        }
    }
    (control, program)
}

/// What an answer says is what is so.
fn judge(setting: Setting, verb: &str, expected: u16) {
    let dir = tempfile::tempdir().expect("writable");
    let (_control, program) = gateway(setting, dir.path());
    let answer = program.post(&format!("/api/{verb}"), "");
    let what = format!("{verb} in {setting:?}: {}", answer.body);
    assert_eq!(answer.status, expected, "{what}");
    let told = answer.json();
    assert_eq!(told["error"].is_string(), expected == 409, "{what}");
    // The state is published some cycles later.
    let is_armed = matches!(setting, Arming | Compensating | HoldingInAnAlarm);
    let so = program.wait(|state| match (verb, expected) {
        ("arm", 200) => state["armed"] == true,
        ("arm" | "disarm", _) => state["armed"] == false,
        (_, 409) => state["armed"] == is_armed,
        _ => state["state"] != "faulted",
    });
    assert!(so.is_ok(), "{what}: {so:?}");
    if expected == 409 {
        let reasons = told["reasons"].as_array().expect("a list");
        assert!(!reasons.is_empty(), "{what}");
    }
}

/// It ends in order, and leaves nothing applied where the control takes writes.
fn ends(setting: Setting) {
    let dir = tempfile::tempdir().expect("writable");
    let (control, mut program) = gateway(setting, dir.path());
    program.signal("TERM");
    assert_eq!(program.end(), Some(0), "{setting:?}");
    std::thread::sleep(Duration::from_millis(20));
    if matches!(setting, Disarmed | Arming | Compensating | Faulted) {
        assert_eq!(control.world().shifts(), [0.0; 3], "{setting:?}");
    }
}

#[test]
fn every_request_in_every_state() {
    std::thread::scope(|scope| {
        for (setting, statuses) in TABLE {
            scope.spawn(move || {
                for (verb, expected) in ["arm", "disarm", "acknowledge"].into_iter().zip(statuses) {
                    judge(setting, verb, expected);
                }
                ends(setting);
            });
        }
    });
}
