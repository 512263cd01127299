//! The gateway's `check` and the bridge's HAL file apply the same rules to an INI file.

use std::{path::Path, process::Command};

use volcomp_linuxcnc::Ini;
use volcomp_test_support::{cases, peers};

use crate::ini::{control, expected, mill};

/// Units in an INI file, and whether the bridge accepts them. LinuxCNC 2.9 (`EmcIniFile` of Debian 12) reads units only
/// in `[TRAJ]`. It accepts mm, metric, in, inch, imperial, deg, degree, grad, gon, rad and radian in any case, and
/// numbers followed by any text. It does not start with other words or with a comment after a word.
const UNITS: [(&str, &str, bool); 28] = [
    ("LINEAR_UNITS", "mm", true),
    ("LINEAR_UNITS", "MM", true),
    ("LINEAR_UNITS", "metric", true),
    ("LINEAR_UNITS", "Metric", true),
    ("LINEAR_UNITS", "in", false),
    ("LINEAR_UNITS", "inch", false),
    ("LINEAR_UNITS", "INCH", false),
    ("LINEAR_UNITS", "imperial", false),
    ("LINEAR_UNITS", "cm", false),
    ("LINEAR_UNITS", "m", false),
    ("LINEAR_UNITS", "millimetre", false),
    ("LINEAR_UNITS", "mm # of the frame", false),
    ("LINEAR_UNITS", "1", false),
    ("LINEAR_UNITS", "1.0 inch", false),
    ("LINEAR_UNITS", "0.03937007874", false),
    ("LINEAR_UNITS", "degree", false),
    ("ANGULAR_UNITS", "degree", true),
    ("ANGULAR_UNITS", "Degree", true),
    ("ANGULAR_UNITS", "deg", true),
    ("ANGULAR_UNITS", "DEG", true),
    ("ANGULAR_UNITS", "degrees", false),
    ("ANGULAR_UNITS", "grad", false),
    ("ANGULAR_UNITS", "gon", false),
    ("ANGULAR_UNITS", "rad", false),
    ("ANGULAR_UNITS", "radian", false),
    ("ANGULAR_UNITS", "1", false),
    ("ANGULAR_UNITS", "deg ; of the table", false),
    ("ANGULAR_UNITS", "mm", false),
];

/// Changes of the shipped file that both `check` and the HAL file reject: old text, new text, and expected message. The
/// last three new texts are numbers in Rust, Tcl or C, but are still rejected.
const REFUSED: &str = r"
LINEAR_UNITS = mm\n |  | [TRAJ]LINEAR_UNITS is missing, expected mm or metric: the bridge counts in this unit
ANGULAR_UNITS = degree\n |  | [TRAJ]ANGULAR_UNITS is missing, expected degree or deg: the bridge counts in this unit
JOINTS = 3\n |  | [KINS]JOINTS is missing, expected the number of joints, 1 to 16
JOINTS = 3 | JOINTS = three | [KINS]JOINTS: found three, expected the number of joints, 1 to 16 without further text
JOINTS = 3 | JOINTS = 3 # X Y Z | [KINS]JOINTS: found 3 # X Y Z, expected the number of joints, 1 to 16
JOINTS = 3 | JOINTS = 2.5 | [KINS]JOINTS: found 2.5, 
JOINTS = 3 | JOINTS = 0 | [KINS]JOINTS: found 0, 
JOINTS = 3 | JOINTS = 17 | [KINS]JOINTS: found 17, 
SERVO_PERIOD = 1000000 | SERVO_PERIOD = 1 ms | [EMCMOT]SERVO_PERIOD: found 1 ms
SERVO_PERIOD = 1000000 | SERVO_PERIOD = 0 | [EMCMOT]SERVO_PERIOD: found 0
LIMIT_UM = 30 | LIMIT_UM = 30 # um | [VOLCOMP]LIMIT_UM: found 30 # um, expected a number without further text
LIMIT_UM = 30 | LIMIT_UM = 3_0 | [VOLCOMP]LIMIT_UM: found 3_0, expected a number without further text
LIMIT_UM = 30 | LIMIT_UM = 0x1e | [VOLCOMP]LIMIT_UM: found 0x1e, expected a number without further text
MIN_LIMIT = -10\nMAX_LIMIT = 400\n[JOINT_2] | MIN_LIMIT = -10\nMAX_LIMIT = 401\n[JOINT_2] | [JOINT_1]MAX_LIMIT: found 401, expected at most 400, [AXIS_Y]MAX_LIMIT
MIN_LIMIT = -10\nMAX_LIMIT = 400\n[JOINT_2] | MAX_LIMIT = 400\n[JOINT_2] | [JOINT_1]MIN_LIMIT: found none, expected at least -10, [AXIS_Y]MIN_LIMIT
MIN_LIMIT = -10\nMAX_LIMIT = 400\n[JOINT_2] | MIN_LIMIT = -10\nMAX_LIMIT = 0x190\n[JOINT_2] | [JOINT_1]MAX_LIMIT: found 0x190, expected at most 400, [AXIS_Y]MAX_LIMIT
MIN_LIMIT = -10\nMAX_LIMIT = 400\n[JOINT_2] | MIN_LIMIT = -012\nMAX_LIMIT = 400\n[JOINT_2] | [JOINT_1]MIN_LIMIT: found -012, expected at least -10, [AXIS_Y]MIN_LIMIT
JOINTS = 3\nKINEMATICS = trivkins coordinates=XYZ | JOINTS = 4\nKINEMATICS = trivkins coordinates=xyyz kinstype=BOTH | [JOINT_2]MIN_LIMIT: found -300, expected at least -10, [AXIS_Y]MIN_LIMIT
LIMIT_UM = 30 | LIMIT_UM = nan | [VOLCOMP]LIMIT_UM: found nan, expected a number without further text
";

/// Changes of the shipped file that only the bridge rejects: old text, new text, and expected message.
const NEEDED: &str = r"
MACHINE = 1\n |  | [VOLCOMP]MACHINE is missing, expected a
LIMIT_UM = 30\n |  | [VOLCOMP]LIMIT_UM is missing, expected a number
RATE_UM_PER_S = 2000\n |  | [VOLCOMP]RATE_UM_PER_S is missing, expected a number
AXES = XYZ\n | AXES = XYZ\nREADS = AX\n | [VOLCOMP]AXES and READS: found XYZ and AX, expected one or more axes, each once
";

fn message(command: &mut Command, ini: &str) -> (bool, String) {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mill.ini");
    std::fs::write(&file, ini).unwrap();
    let output = command.arg(&file).output().unwrap();
    let message = String::from_utf8(output.stderr).unwrap();
    let names = message.contains(&file.display().to_string());
    assert!(
        output.status.success() || names && message.lines().count() == 1,
        "one line that names the file: {message}"
    );
    (output.status.success(), message)
}

/// The bridge's HAL file, run without LinuxCNC; `None` without Tcl.
fn bridge() -> Option<Command> {
    const TCL: &str = "/usr/bin/tclsh";
    if !Path::new(TCL).exists() {
        peers::not_run("tclsh of linuxcnc-uspace");
        return None;
    }
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut command = Command::new(TCL);
    command.arg(here.join("tests/it/stand_in.tcl")).arg(here.join("bridge/volcomp.tcl"));
    Some(command)
}

fn check_by_bridge(ini: &str) -> Option<(bool, String)> {
    Some(message(&mut bridge()?, ini))
}

fn check_by_gateway(ini: &str) -> (bool, String) {
    let problems = Ini::parse(ini).problems(&expected(&control()));
    let message: Vec<String> = problems.iter().map(ToString::to_string).collect();
    (message.is_empty(), message.join("\n"))
}

/// A pin that an earlier file has connected keeps its signal, also where other pins begin with its name.
#[test]
fn a_connected_pin_keeps_its_signal() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mill.ini");
    std::fs::write(&file, mill()).unwrap();
    let Some(mut bridge) = bridge() else { return };
    let output = bridge.arg(&file).env("CONNECTED", "axis.x.eoffset").output().unwrap();
    let nets = String::from_utf8(output.stdout).unwrap();
    assert!(nets.contains("net own => volcomp.eoffset-0\n"), "{nets}");
}

/// A zero in front changes no number: for Tcl 030 alone would be 24, and 08 none.
#[test]
fn numbers_are_decimal() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mill.ini");
    let Some(mut bridge) = bridge() else { return };
    bridge.arg(&file);
    let mut orders = |ini: &str| {
        std::fs::write(&file, ini).unwrap();
        let output = bridge.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    let zeros = mill()
        .replace("LIMIT_UM = 30\n", "LIMIT_UM = 030\n")
        .replace("MACHINE = 1\n", "MACHINE = 01\nHOLD_MS = 0100\nPORT = 047001\n");
    assert_ne!(zeros, mill());
    assert_eq!(orders(&zeros), orders(&mill()));
}

/// For each program: its name, whether it accepts the file, and its messages.
fn check_by_both(ini: &str) -> Vec<(&'static str, bool, String)> {
    let results = [("check", Some(check_by_gateway(ini))), ("volcomp.tcl", check_by_bridge(ini))];
    let results = results.into_iter();
    results
        .filter_map(|(program, results)| {
            results.map(|(accepts, message)| (program, accepts, message))
        })
        .collect()
}

#[test]
fn both_accept_the_shipped_file() {
    for (program, accepts, message) in check_by_both(&mill()) {
        assert!(accepts && message.is_empty(), "{program}: {message}");
    }
}

#[test]
fn both_apply_the_same_rule_to_units() {
    for (key, found, accepts) in UNITS {
        let (from, words) = match key {
            "LINEAR_UNITS" => ("LINEAR_UNITS = mm\n", "mm or metric"),
            _ => ("ANGULAR_UNITS = degree\n", "degree or deg"),
        };
        let ini = mill();
        assert!(ini.contains(from));
        let results = check_by_both(&ini.replace(from, &format!("{key} = {found}\n")));
        let says = format!(
            "[TRAJ]{key}: found {found}, expected {words}: the bridge counts in this unit, and no other is supported. Do not change this key alone: all lengths or angles of the INI file are in it"
        );
        for (program, does, message) in results {
            assert_eq!(does, accepts, "{program}: {key} = {found}: {message}");
            assert!(accepts || message.contains(&says), "{program}: {message}");
        }
    }
}

#[test]
fn unknown_keys_are_reported_by_check_and_the_hal_file() {
    let ini = mill().replace("[VOLCOMP]\n", "[VOLCOMP]\nHOLDMS = 50\n");
    assert_ne!(ini, mill());
    let keys = "MACHINE, AXES, READS, PORT, LISTEN, STEP_NM, STEP_UDEG, LIMIT_UM, LIMIT_MDEG, RATE_UM_PER_S, RATE_MDEG_PER_S, HOLD_MS, TIME_OUT_MS, EPOCH_FILE, KEY_FILE";
    let says = format!("[VOLCOMP]HOLDMS: unknown key, expected one of {keys}");
    for (program, accepts, message) in check_by_both(&ini) {
        assert!(!accepts && message.contains(&says), "{program}: {message}");
    }
    // Each expected key of the message must be a known key.
    for key in keys.split(", ").filter(|key| !mill().contains(key)) {
        let ini = mill().replace("[VOLCOMP]\n", &format!("[VOLCOMP]\n{key} = 1\n"));
        for (program, _, message) in check_by_both(&ini) {
            assert!(!message.contains("unknown key"), "{program}: {message}");
        }
    }
}

#[test]
fn both_report_missing_and_wrong_lines() {
    for [from, to, says] in &cases(REFUSED) {
        let ini = mill();
        assert!(ini.contains(from), "{from}");
        for (program, accepts, message) in check_by_both(&ini.replace(from, to)) {
            assert!(!accepts && message.contains(says), "{program}: {says}: {message}");
        }
    }
    for [from, to, says] in &cases(NEEDED) {
        let ini = mill();
        assert!(ini.contains(from), "{from}");
        let ini = ini.replace(from, to);
        if let Some((accepts, message)) = check_by_bridge(&ini) {
            assert!(!accepts && message.contains(says), "{says}: {message}");
        }
    }
}
