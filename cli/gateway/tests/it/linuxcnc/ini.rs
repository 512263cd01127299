//! `check` looks through the INI file of the control.

use std::process::Command;

use volcomp_test_support::root;

use crate::program::path;

/// The shipped example with this change in its INI file: the status of `check`, and what it says.
fn check(from: &str, to: &str) -> (Option<i32>, String) {
    let dir = tempfile::tempdir().expect("writable");
    for file in ["gateway.toml", "machine.toml", "mill.ini"] {
        let text = std::fs::read_to_string(root().join("examples/linuxcnc").join(file));
        let mut text = text.expect("shipped");
        if file == "mill.ini" {
            assert!(text.contains(from), "{from}");
            text = text.replace(from, to);
        }
        std::fs::write(dir.path().join(file), text).expect("writable");
    }
    let output = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
        .args(["check", path(&dir.path().join("gateway.toml"))])
        .output()
        .expect("it runs");
    let said = [output.stdout, output.stderr].concat();
    (
        output.status.code(),
        String::from_utf8_lossy(&said).into_owned(),
    )
}

#[test]
fn check_names_what_is_missing_in_the_file() {
    let (status, said) = check("[JOINT_0]", "[JOINT_0]");
    assert_eq!(status, Some(0), "{said}");
    for (from, to, says) in [
        (
            "[JOINT_0]\n",
            "[JOINT_0]\nBACKLASH = 0.01\n",
            "[JOINT_0]BACKLASH",
        ),
        (
            "[JOINT_2]\n",
            "[JOINT_2]\nCOMP_FILE = z.comp\n",
            "[JOINT_2]COMP_FILE",
        ),
        ("volcomp.tcl", "nothing.tcl", "[HAL]HALFILE"),
        (
            "[AXIS_Z]\nOFFSET_AV_RATIO = 0.02",
            "[AXIS_Z]",
            "[AXIS_Z]OFFSET_AV_RATIO is missing",
        ),
        (
            "LIMIT_UM = 30",
            "LIMIT_UM = 5",
            "[VOLCOMP]LIMIT_UM: found 5, expected 30 or more",
        ),
        (
            "RATE_UM_PER_S = 2000",
            "RATE_UM_PER_S = 10",
            "[VOLCOMP]RATE_UM_PER_S: found 10, expected 1000 or more",
        ),
        (
            "RATE_UM_PER_S = 2000",
            "RATE_UM_PER_S = 2000\nTIME_OUT_MS = 1100",
            "[VOLCOMP]TIME_OUT_MS: found 1100, expected 1000 or less",
        ),
        (
            "[JOINT_1]\n",
            "[JOINT_1]\n#INCLUDE comp.inc\n",
            "#INCLUDE comp.inc",
        ),
    ] {
        let (status, said) = check(from, to);
        assert_eq!(status, Some(2), "{said}");
        assert!(said.contains(says) && said.contains("mill.ini"), "{said}");
    }
}
