//! Bridges whose axes do not follow their requests, and settings with which LinuxCNC must not start.

use std::time::Duration;

use volcomp_test_support::rows;

use super::{
    MOST, PORT, alone::alone, corrected_at, gateway, no_jump, offsets, peer::LinuxCnc, wait_zero,
};
use crate::online::check;

alone!(adrift: settings_that_do_not_fit_start_nothing, in_joint_mode_nothing_is_requested, an_offset_that_does_not_come_is_an_alarm);

/// LinuxCNC moves offsets with its own planner, but not in joint mode. An offset requested in joint mode would later
/// take effect as a jump, so the bridge requests none.
fn in_joint_mode_nothing_is_requested() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut control, mut program) = corrected_at("X300 Y40 Z-20", dir.path(), |ini| ini);

    // The output of `check --online`.
    let config = super::configuration(dir.path(), PORT);
    let (text, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 0, "{errors}");
    for line in [
        "# protocol = 2\n",
        "# state = \"on, homed\"\n",
        "# hold_ms = 100.0\n",
        "# time_out_ms = 300.0\n",
        "#   { name = \"X\", unit = \"µm\", limit = 30.0, rate_per_s = 2000.0 },\n",
    ] {
        assert!(text.contains(line), "{line}{text}");
    }
    assert!(!text.contains("shift words"), "{text}");

    let held = offsets(&mut control);
    let pin = "volcomp.counts-0";
    let counts = control.pin(pin);
    control.do_it("joint_mode");
    let seen = program.wait(|state| state["reasons"].to_string().contains("alarm"));
    seen.unwrap_or_else(|state| panic!("the mode is not reported: {state}"));
    let (text, _, _) = check(&config, &["--online"]);
    assert!(
        text.contains("on, homed, an offset is lost, not reached, or does not move in this mode"),
        "{text}"
    );
    program.running.kill();
    std::thread::sleep(Duration::from_secs(2));
    assert_eq!(offsets(&mut control), held);
    assert_eq!(control.pin(pin), counts);
    assert_eq!(control.pin("volcomp.holds"), 1.0);
    // When LinuxCNC moves offsets again, the barrier removes the correction at its rate.
    let cycles = control.record(|control| {
        control.mdi("G0 X300");
        wait_zero(control);
    });
    no_jump(&cycles, MOST);
}

/// Without its share of the velocity the planner does not move an offset. The missing correction raises an alarm.
fn an_offset_that_does_not_come_is_an_alarm() {
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), |ini| {
        // The component must tolerate that HAL files are read twice.
        let ini = ini.replace("[HAL]\n", "[HAL]\nTWOPASS = ON\n");
        ini.replace("OFFSET_AV_RATIO = 0.02\n", "")
    });
    let program = gateway(dir.path(), PORT);
    control.do_it("up");
    control.mdi("G21 G90 G0 X300 Y40 Z-20");
    let seen = program.wait(|state| state["reasons"].to_string().contains("alarm"));
    seen.unwrap_or_else(|state| panic!("the missing offset is not reported: {state}"));
    // A requested offset that does not take effect is reported continuously.
    control.wait("axis.x.eoffset-request", |asked| asked.abs() > 2e-3);
    std::thread::sleep(Duration::from_secs(2));
    let state = program.state();
    assert!(state["reasons"].to_string().contains("alarm"), "{state}");
    assert_eq!(control.pin("volcomp.holds"), 1.0);
    assert_eq!(offsets(&mut control), [0.0; 3]);
}

/// LinuxCNC does not start with a wrong setting, and its log names the setting.
fn settings_that_do_not_fit_start_nothing() {
    for [from, to, says] in rows(
        r"
LINEAR_UNITS = mm | LINEAR_UNITS = inch | [TRAJ]LINEAR_UNITS: found inch, expected mm
ANGULAR_UNITS = degree\n |  | [TRAJ]ANGULAR_UNITS is missing, expected degree
LIMIT_UM = 30 | LIMIT_UM = 30 # um | [VOLCOMP]LIMIT_UM: found 30 # um, expected a number
LIMIT_UM = 30 | LIMIT_UM = 30\nHOLD_MS = 65636\nTIME_OUT_MS = 65836 | hold_scans (HOLD_MS): found 65636 cycles, expected 1 to 16383
LIMIT_UM = 30 | LIMIT_UM = 40 | limit (LIMIT_UM, LIMIT_MDEG) of axis X: found 40000 counts, expected 1 to 32767
LIMIT_UM = 30 | LIMIT_UM = 30\nKEY_FILE = other.key | other.key cannot be read: No such file or directory
",
    ) {
        let dir = tempfile::tempdir().expect("writable");
        let started = std::panic::catch_unwind(|| {
            LinuxCnc::start(dir.path(), |ini| {
                assert!(ini.contains(from), "{from}");
                ini.replace(from, to)
            })
        });
        assert!(started.is_err(), "it started: {to}");
        let log = std::fs::read_to_string(dir.path().join("linuxcnc.log")).expect("a log");
        assert!(log.contains(says), "{says}: {log}");
    }
}
