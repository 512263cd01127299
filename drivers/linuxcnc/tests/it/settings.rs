//! An INI file is judged by one rule in `check` and in the bridge's HAL file.

use std::{path::Path, process::Command};

use volcomp_linuxcnc::Ini;
use volcomp_test_support::{cases, peers};

use crate::ini::{control, expected, mill};

/// Units that may stand in an INI file, and whether the bridge accepts them. LinuxCNC 2.9 (`EmcIniFile`, tried with the library of
/// Debian 12) takes mm, metric, in, inch and imperial, deg, degree, grad, gon, rad and radian in any case, and numbers, whatever
/// stands behind them; other words, and comments behind a word, stop it. It reads units in `[TRAJ]` alone.
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

/// Lines of the shipped file, what takes their place, and what all say of it. Of the languages that read the last three each takes
/// one for a number.
const REFUSED: &str = r"
LINEAR_UNITS = mm\n |  | [TRAJ]LINEAR_UNITS is missing, expected mm or metric: the bridge counts in this unit
ANGULAR_UNITS = degree\n |  | [TRAJ]ANGULAR_UNITS is missing, expected degree or deg: the bridge counts in this unit
JOINTS = 3\n |  | [KINS]JOINTS is missing, expected the number of joints, 1 to 16
JOINTS = 3 | JOINTS = three | [KINS]JOINTS: found three, expected the number of joints, 1 to 16 and nothing behind it
JOINTS = 3 | JOINTS = 3 # X Y Z | [KINS]JOINTS: found 3 # X Y Z, expected the number of joints, 1 to 16
JOINTS = 3 | JOINTS = 2.5 | [KINS]JOINTS: found 2.5, 
JOINTS = 3 | JOINTS = 0 | [KINS]JOINTS: found 0, 
JOINTS = 3 | JOINTS = 17 | [KINS]JOINTS: found 17, 
SERVO_PERIOD = 1000000 | SERVO_PERIOD = 1 ms | [EMCMOT]SERVO_PERIOD: found 1 ms
SERVO_PERIOD = 1000000 | SERVO_PERIOD = 0 | [EMCMOT]SERVO_PERIOD: found 0
LIMIT_UM = 30 | LIMIT_UM = 30 # um | [VOLCOMP]LIMIT_UM: found 30 # um, expected a number and nothing behind it
LIMIT_UM = 30 | LIMIT_UM = 3_0 | [VOLCOMP]LIMIT_UM: found 3_0, expected a number and nothing behind it
LIMIT_UM = 30 | LIMIT_UM = 0x1e | [VOLCOMP]LIMIT_UM: found 0x1e, expected a number and nothing behind it
LIMIT_UM = 30 | LIMIT_UM = nan | [VOLCOMP]LIMIT_UM: found nan, expected a number and nothing behind it
";

/// What only the bridge judges.
const NEEDED: &str = r"
MACHINE = 1\n |  | [VOLCOMP]MACHINE is missing, expected a
LIMIT_UM = 30\n |  | [VOLCOMP]LIMIT_UM is missing, expected a number
RATE_UM_PER_S = 2000\n |  | [VOLCOMP]RATE_UM_PER_S is missing, expected a number
AXES = XYZ\n | AXES = XYZ\nREADS = AX\n | [VOLCOMP]AXES and READS: found XYZ and AX, expected one or more axes, each once
";

/// What a program says of an INI file, and whether it takes it.
fn said(command: &mut Command, ini: &str) -> (bool, String) {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mill.ini");
    std::fs::write(&file, ini).unwrap();
    let output = command.arg(&file).output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    let names = said.contains(&file.display().to_string());
    assert!(
        output.status.success() || names && said.lines().count() == 1,
        "one line that names the file: {said}"
    );
    (output.status.success(), said)
}

fn of_tcl(ini: &str) -> Option<(bool, String)> {
    const TCL: &str = "/usr/bin/tclsh";
    if !Path::new(TCL).exists() {
        peers::not_run("tclsh of linuxcnc-uspace");
        return None;
    }
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut command = Command::new(TCL);
    command
        .arg(here.join("tests/it/stand_in.tcl"))
        .arg(here.join("bridge/volcomp.tcl"));
    Some(said(&mut command, ini))
}

fn of_check(ini: &str) -> (bool, String) {
    let problems = Ini::parse(ini).problems(&expected(&control()));
    let said: Vec<String> = problems.iter().map(ToString::to_string).collect();
    (said.is_empty(), said.join("\n"))
}

/// What both say, each with its name.
fn of_all(ini: &str) -> Vec<(&'static str, bool, String)> {
    let told = [("check", Some(of_check(ini))), ("volcomp.tcl", of_tcl(ini))];
    let told = told.into_iter();
    told.filter_map(|(who, told)| told.map(|(takes, said)| (who, takes, said)))
        .collect()
}

#[test]
fn the_shipped_file_is_taken_by_all() {
    for (who, takes, said) in of_all(&mill()) {
        assert!(takes && said.is_empty(), "{who}: {said}");
    }
}

#[test]
fn units_are_judged_by_one_rule() {
    for (key, found, takes) in UNITS {
        let (from, words) = match key {
            "LINEAR_UNITS" => ("LINEAR_UNITS = mm\n", "mm or metric"),
            _ => ("ANGULAR_UNITS = degree\n", "degree or deg"),
        };
        let ini = mill();
        assert!(ini.contains(from));
        let told = of_all(&ini.replace(from, &format!("{key} = {found}\n")));
        let says = format!(
            "[TRAJ]{key}: found {found}, expected {words}: the bridge counts in this unit, and no other is supported. Do not change this key alone: all lengths or angles of the INI file are in it"
        );
        for (who, does, said) in told {
            assert_eq!(does, takes, "{who}: {key} = {found}: {said}");
            assert!(takes || said.contains(&says), "{who}: {said}");
        }
    }
}

#[test]
fn unknown_keys_are_reported_by_check_and_the_hal_file() {
    let ini = mill().replace("[VOLCOMP]\n", "[VOLCOMP]\nHOLDMS = 50\n");
    assert_ne!(ini, mill());
    let keys = "MACHINE, AXES, READS, PORT, LISTEN, STEP_NM, STEP_UDEG, LIMIT_UM, LIMIT_MDEG, RATE_UM_PER_S, RATE_MDEG_PER_S, HOLD_MS, TIME_OUT_MS, EPOCH_FILE, KEY_FILE";
    let says = format!("[VOLCOMP]HOLDMS: unknown key, expected one of {keys}");
    for (who, takes, said) in of_all(&ini) {
        assert!(!takes && said.contains(&says), "{who}: {said}");
    }
    // Each of these is a key.
    for key in keys.split(", ").filter(|key| !mill().contains(key)) {
        let ini = mill().replace("[VOLCOMP]\n", &format!("[VOLCOMP]\n{key} = 1\n"));
        for (who, _, said) in of_all(&ini) {
            assert!(!said.contains("unknown key"), "{who}: {said}");
        }
    }
}

#[test]
fn what_is_missing_or_wrong_is_told_by_all() {
    for [from, to, says] in &cases(REFUSED) {
        let ini = mill();
        assert!(ini.contains(from), "{from}");
        for (who, takes, said) in of_all(&ini.replace(from, to)) {
            assert!(!takes && said.contains(says), "{who}: {says}: {said}");
        }
    }
    for [from, to, says] in &cases(NEEDED) {
        let ini = mill();
        assert!(ini.contains(from), "{from}");
        let ini = ini.replace(from, to);
        if let Some((takes, said)) = of_tcl(&ini) {
            assert!(!takes && said.contains(says), "{says}: {said}");
        }
    }
}
