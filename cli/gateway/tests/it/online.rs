//! `check --online` asks the control and compares; without it nothing is opened.

use std::{
    path::Path,
    process::{Command, Output},
};

use serde_json::Value;

use crate::{
    controlled::{configuration, control},
    program::path,
};

pub(crate) fn check(config: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
        .args(["check", path(config)])
        .args(more)
        .output()
        .expect("it was built for this test")
}

/// Standard output and standard error, and the exit status.
pub(crate) fn said(output: &Output) -> (String, String, Option<i32>) {
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    let (out, errors) = (text(&output.stdout), text(&output.stderr));
    (out, errors, output.status.code())
}

#[test]
fn a_control_is_asked_from_which_words_it_takes_the_shifts() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = configuration(dir.path(), &control, "");
    let (text, errors, status) = said(&check(&config, &["--online"]));
    assert_eq!(status, Some(0), "{errors}");
    assert!(
        text.contains("shift words         from R100 on (parameter 1280)"),
        "{text}"
    );
    let (json, ..) = said(&check(&config, &["--online", "--json"]));
    let document: Value = serde_json::from_str(&json).expect("JSON");
    crate::documents::validate("gateway-check.json", &document);
    assert_eq!(document["online"][0]["shift_words"], 100, "{json}");
    // It takes them from other words: refused, and the parameter named.
    control.world().parameters.insert((1280, 0), 300.0);
    let (_, errors, status) = said(&check(&config, &["--online"]));
    assert_eq!(status, Some(1), "{errors}");
    assert!(
        errors.contains("parameter 1280 of the control")
            && errors.contains("found 300, expected 100"),
        "{errors}"
    );
    // It does not tell: a note.
    control.world().parameters.clear();
    control.world().tells_shift_source = false;
    let (text, errors, status) = said(&check(&config, &["--online"]));
    assert_eq!(status, Some(0), "{errors}");
    assert!(
        text.contains("note: the control does not tell parameters 1203"),
        "{text}"
    );
    // Offline nothing is asked, and a control that is not there is no matter.
    let asked = control.requests();
    let (json, _, status) = said(&check(&config, &["--json"]));
    assert_eq!(status, Some(0));
    assert!(!json.contains("\"online\""), "{json}");
    assert_eq!(control.requests(), asked);
    drop(control);
    assert_eq!(said(&check(&config, &[])).2, Some(0));
    assert_eq!(said(&check(&config, &["--online"])).2, Some(1));
}
