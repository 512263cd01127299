//! The bridge in the servo thread where the axes do not have what it asks for, and where it must not start at all.

use std::time::Duration;

use super::{
    gateway, no_jump, offsets,
    peer::{Bridge, LinuxCnc, alone, can_build},
    wait_corrected, wait_zero,
};
use crate::online::{check, said};

const PORT: u16 = 47_001;
const MOST: f64 = 0.005;

/// LinuxCNC moves offsets by its own planner: not in joint mode, where what was asked for would come as a jump later, and not
/// without its share of velocity.
#[test]
fn joint_mode_and_a_planner_that_does_not_move() {
    if !can_build() {
        return;
    }
    let Some(_alone) = alone("adrift::joint_mode_and_a_planner_that_does_not_move") else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), Bridge::Servo, |ini| ini);
    let mut program = gateway(dir.path(), PORT);
    control.do_it("up");
    control.mdi("G21 G90 G0 X50 Y40 Z-20");
    wait_corrected(&mut control, &program);

    // What `check --online` says of it.
    let config = super::configuration(dir.path(), PORT);
    let (text, errors, status) = said(&check(&config, &["--online"]));
    assert_eq!(status, Some(0), "{errors}");
    for line in [
        "  protocol            version 1\n",
        "  state               on, homed\n",
        "    oldest frame      100 ms\n",
        "    time-out          300 ms\n",
        "    axis X            limit 30 µm, rate 2000 µm/s\n",
    ] {
        assert!(text.contains(line), "{line}{text}");
    }
    assert!(!text.contains("shift words"), "{text}");

    let held = offsets(&mut control);
    let counts = control.pin("volcomp.counts-0");
    control.do_it("joint_mode");
    let seen = program.wait(|state| state["reasons"].to_string().contains("alarm"));
    seen.unwrap_or_else(|state| panic!("nobody sees the mode: {state}"));
    let (text, _, _) = said(&check(&config, &["--online"]));
    assert!(
        text.contains("on, homed, an offset is lost, not reached, or does not move in this mode"),
        "{text}"
    );
    program.running.kill();
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(offsets(&mut control), held);
    assert_eq!(control.pin("volcomp.counts-0"), counts);
    assert_eq!(control.pin("volcomp.holds"), 1.0);
    // Back in a mode in which offsets move, the barrier takes it out at its own rate.
    let cycles = control.record(|control| {
        control.mdi("G0 X50");
        wait_zero(control);
    });
    no_jump(&cycles, MOST);
    drop(program);
    drop(control);

    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), Bridge::Servo, |ini| {
        // HAL files that are read twice do not matter.
        let ini = ini.replace("[HAL]\n", "[HAL]\nTWOPASS = ON\n");
        ini.replace("OFFSET_AV_RATIO = 0.02\n", "")
    });
    let program = gateway(dir.path(), PORT);
    control.do_it("up");
    control.mdi("G21 G90 G0 X50 Y40 Z-20");
    let seen = program.wait(|state| state["reasons"].to_string().contains("alarm"));
    seen.unwrap_or_else(|state| panic!("nobody sees that no offset comes: {state}"));
    assert_eq!(offsets(&mut control), [0.0; 3]);
}

/// Each is named in the log of LinuxCNC, which does not start.
#[test]
fn settings_that_do_not_fit_start_nothing() {
    if !can_build() {
        return;
    }
    let Some(_alone) = alone("adrift::settings_that_do_not_fit_start_nothing") else {
        return;
    };
    // The component that was built lies in the folder of a start, and is that of the next one, too.
    let mut folders = Vec::new();
    for (from, to, says) in [
        (
            "LINEAR_UNITS = mm",
            "LINEAR_UNITS = inch",
            "[TRAJ]LINEAR_UNITS: found inch, expected mm",
        ),
        (
            "ANGULAR_UNITS = degree\n",
            "",
            "[TRAJ]ANGULAR_UNITS is missing, expected degree",
        ),
        (
            "LIMIT_UM = 30",
            "LIMIT_UM = 30 # um",
            "[VOLCOMP]LIMIT_UM: found 30 # um, expected a number",
        ),
        (
            "LIMIT_UM = 30",
            "LIMIT_UM = 30\nHOLD_MS = 65636\nTIME_OUT_MS = 65836",
            "hold_scans (HOLD_MS): found 65636 cycles, expected 1 to 16383",
        ),
        (
            "LIMIT_UM = 30",
            "LIMIT_UM = 40",
            "limit (LIMIT_UM, LIMIT_MDEG) of axis X: found 40000 counts, expected 1 to 32767",
        ),
    ] {
        let dir = tempfile::tempdir().expect("writable");
        let started = std::panic::catch_unwind(|| {
            LinuxCnc::start(dir.path(), Bridge::Servo, |ini| {
                assert!(ini.contains(from), "{from}");
                ini.replace(from, to)
            })
        });
        assert!(started.is_err(), "it started: {to}");
        let log = std::fs::read_to_string(dir.path().join("linuxcnc.log")).expect("a log");
        assert!(log.contains(says), "{says}: {log}");
        folders.push(dir);
    }
}
