//! The bridge in user space where it must not start at all, and what its parts make of numbers.

use std::{path::Path, process::Command};

use volcomp_test_support::root;

use super::{
    alone::{alone, is_there},
    peer::{Bridge, LinuxCnc},
};

/// What the bridge says of the shipped INI file with this change; it never gets as far as HAL.
fn refused(from: &str, to: &str) -> String {
    let dir = tempfile::tempdir().expect("writable");
    let ini = std::fs::read_to_string(root().join("examples/linuxcnc/mill.ini")).expect("shipped");
    assert!(ini.contains(from), "{from}");
    let path = dir.path().join("mill.ini");
    std::fs::write(&path, ini.replace(from, to)).expect("writable");
    let output = Command::new("/usr/bin/python3")
        .arg("-B")
        .arg(root().join("drivers/linuxcnc/bridge/volcomp_bridge.py"))
        .arg(&path)
        .output()
        .expect("python3");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{to}: {said}");
    said
}

#[test]
fn settings_that_do_not_fit_are_refused_by_name() {
    if !is_there() {
        return;
    }
    for (from, to, says) in [
        (
            "LINEAR_UNITS = mm",
            "LINEAR_UNITS = inch",
            "[TRAJ]LINEAR_UNITS: found inch, expected mm",
        ),
        (
            "LINEAR_UNITS = mm\n",
            "",
            "[TRAJ]LINEAR_UNITS is missing, expected mm",
        ),
        (
            "ANGULAR_UNITS = degree",
            "ANGULAR_UNITS = rad",
            "[TRAJ]ANGULAR_UNITS: found rad, expected degree",
        ),
        // LinuxCNC's own reader takes what stands behind a word for a part of it, and nothing for nothing.
        (
            "LINEAR_UNITS = mm",
            "LINEAR_UNITS = mm # of the frame",
            "[TRAJ]LINEAR_UNITS: found mm # of the frame, expected mm or metric",
        ),
        (
            "JOINTS = 3\n",
            "",
            "[KINS]JOINTS is missing, expected the number of joints, 1 to 16",
        ),
        (
            "AXES = XYZ",
            "AXES = XYQ",
            "[VOLCOMP]AXES: found Q, expected axes of X Y Z",
        ),
        (
            "AXES = XYZ",
            "AXES = XYZ\nREADS = AX",
            "[VOLCOMP]AXES and READS: found XYZ and AX, expected one or more axes, each once",
        ),
        (
            "LIMIT_UM = 30",
            "LIMIT_UM = 30 # um",
            "[VOLCOMP]LIMIT_UM: found 30 # um, expected a number",
        ),
        (
            "LIMIT_UM = 30",
            "LIMIT_UM = nan",
            "[VOLCOMP]LIMIT_UM: found nan, expected a number",
        ),
        (
            "MACHINE = 1\n",
            "MACHINE = 1.5\n",
            "[VOLCOMP]MACHINE: found 1.5, expected a whole number",
        ),
        (
            "LIMIT_UM = 30",
            "LIMIT_UM = 30\nPORT = 70000",
            "[VOLCOMP]PORT: found 70000, expected 0 to 65535",
        ),
        (
            "LIMIT_UM = 30",
            "LIMIT_UM = 40",
            "axis X: found a limit of 40000 counts, expected 1 to 32767",
        ),
    ] {
        let said = refused(from, to);
        assert!(said.contains(says), "{says}: {said}");
    }
}

/// LinuxCNC starts programs in the first of two passes, before there is anything that this one could be connected to.
#[test]
fn two_passes_are_refused_by_name() {
    let Some(_alone) = alone("in_user_space::two_passes_are_refused_by_name") else {
        return;
    };
    let dir = tempfile::tempdir().expect("writable");
    let started = std::panic::catch_unwind(|| {
        LinuxCnc::start(dir.path(), Bridge::User, |ini| {
            ini.replace("[HAL]\n", "[HAL]\nTWOPASS = ON\n")
        })
    });
    assert!(started.is_err(), "it started");
    let log = std::fs::read_to_string(dir.path().join("linuxcnc.log")).expect("a log");
    assert!(
        log.contains("[HAL]TWOPASS: found ON, expected none with volcomp.tcl"),
        "{log}"
    );
}

/// Prints what a program with the bridge's own files says.
fn python(program: &str, arguments: &[&Path]) -> String {
    let output = Command::new("/usr/bin/python3")
        .args(["-B", "-c", program])
        .arg(root().join("drivers/linuxcnc/bridge"))
        .args(arguments)
        .output()
        .expect("python3");
    let errors = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{errors}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// No limit loses a count because a decimal number is not quite what it says.
#[test]
fn a_limit_is_as_many_counts_as_it_says() {
    if !is_there() {
        return;
    }
    let dir = tempfile::tempdir().expect("writable");
    let ini = std::fs::read_to_string(root().join("examples/linuxcnc/mill.ini")).expect("shipped");
    for (limit, counts) in [("1.001", 1001), ("2.3", 2300), ("32.767", 32_767)] {
        let path = dir.path().join("mill.ini");
        let text = ini.replace("LIMIT_UM = 30", &format!("LIMIT_UM = {limit}"));
        std::fs::write(&path, text).expect("writable");
        let found = python(
            "import sys; sys.path.insert(0, sys.argv[1])\n\
             import volcomp_bridge\n\
             print(volcomp_bridge.Configuration(sys.argv[2]).settings.limit[0])",
            &[&path],
        );
        assert_eq!(found.trim(), counts.to_string());
    }
}

/// An offset that no word can tell is not told as another one, takes no frame, and goes to where it can be told.
#[test]
fn an_offset_beyond_the_words_is_not_told() {
    if !is_there() {
        return;
    }
    let found = python(
        "import sys; sys.path.insert(0, sys.argv[1])\n\
         from barrier import Barrier, Settings\n\
         barrier = Barrier(Settings(['X'], 1, [30000], [2000], 1, 100, 300), 0, 0, [-60000])\n\
         assert barrier.report() == []\n\
         for scan in range(40):\n\
         \x20   before = barrier.applied[0]\n\
         \x20   report = barrier.scan([], False)\n\
         \x20   now = barrier.applied[0]\n\
         \x20   assert 0 <= now - before <= 2000, (before, now)\n\
         \x20   assert report == [] if now < -32768 else report[8] == now & 0xFFFF, (now, report)\n\
         print(barrier.applied[0])",
        &[],
    );
    assert_eq!(found.trim(), "0");
}
