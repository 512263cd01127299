//! `check` checks the INI file of the control.

use std::os::unix::fs::PermissionsExt as _;

use volcomp_test_support::{root, rows};

use crate::{manual::machine, online};

/// Runs `check` on the shipped example with a change in its INI file. Returns the status and the errors.
fn check(from: &str, to: &str) -> (u8, String) {
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
    super::key_file(dir.path());
    let (_, said, status) = online::check(&dir.path().join("gateway.toml"), &[]);
    (status, said)
}

#[test]
fn check_names_what_is_missing_in_the_file() {
    let (status, said) = check("[JOINT_0]", "[JOINT_0]");
    assert_eq!(status, 0, "{said}");
    for [from, to, says] in rows(
        r"
[JOINT_0]\n | [JOINT_0]\nBACKLASH = 0.01\n | [JOINT_0]BACKLASH
[JOINT_2]\n | [JOINT_2]\nCOMP_FILE = z.comp\n | [JOINT_2]COMP_FILE
volcomp.tcl | nothing.tcl | [HAL]HALFILE
[AXIS_Z]\nOFFSET_AV_RATIO = 0.02 | [AXIS_Z] | [AXIS_Z]OFFSET_AV_RATIO is missing
LIMIT_UM = 30 | LIMIT_UM = 5 | [VOLCOMP]LIMIT_UM: found 5, expected 30 or more
RATE_UM_PER_S = 2000 | RATE_UM_PER_S = 10 | [VOLCOMP]RATE_UM_PER_S: found 10, expected 1000 or more
RATE_UM_PER_S = 2000 | RATE_UM_PER_S = 2000\nTIME_OUT_MS = 1100 | [VOLCOMP]TIME_OUT_MS: found 1100, expected 1000 or less
[JOINT_1]\n | [JOINT_1]\n#INCLUDE comp.inc\n | #INCLUDE comp.inc
LIMIT_UM = 30 | LIMIT_UM = 30\nKEY_FILE = other.key | [VOLCOMP]KEY_FILE:
",
    ) {
        let (status, said) = check(from, to);
        assert_eq!(status, 2, "{said}");
        assert!(said.contains(says) && said.contains("mill.ini"), "{said}");
    }
}

/// A gateway without a key file does not start. `check` names the error in a key file.
#[test]
fn a_gateway_without_a_key_is_refused() {
    let dir = tempfile::tempdir().expect("writable");
    let config = super::configuration(dir.path(), super::PORT);
    let file = dir.path().join("volcomp.key");
    let text = std::fs::read_to_string(&config).expect("written");
    for (key, mode, table, says) in [
        (Some("00"), 0o600, true, "expected 32 hexadecimal digits"),
        (Some("000102030405060708090a0b0c0d0e0f"), 0o644, true, "found mode 644, expected 600"),
        (None, 0o600, true, "volcomp.key: No such file"),
        (None, 0o600, false, "found no linuxcnc.key_file"),
    ] {
        match key {
            Some(key) => {
                std::fs::write(&file, key).expect("writable");
                let mode = std::fs::Permissions::from_mode(mode);
                std::fs::set_permissions(&file, mode).expect("ours");
            }
            None => _ = std::fs::remove_file(&file),
        }
        let line = "linuxcnc = { key_file = \"volcomp.key\" }\n";
        assert!(text.contains(line), "{text}");
        let with = if table { text.clone() } else { text.replace(line, "") };
        std::fs::write(&config, with).expect("writable");
        let check = online::check(&config, &[]);
        let daemon = machine(&config).plan().err().expect(says);
        assert_eq!((check.2, daemon.status()), (2, 2), "{says}");
        for said in [check.1, daemon.to_string()] {
            assert!(said.contains(says), "{says}: {said}");
        }
    }
}
