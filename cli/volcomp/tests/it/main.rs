//! The real program: what it prints, its JSON, its exit status.

mod answers;
mod bounds;
mod check;
mod correct;
mod evaluation;
mod export;
mod fit_auto;
mod fit_thermal;
mod help;
mod map;
mod map_table;
mod measurement_files;
mod nc;
mod nc_parts;
mod points;
mod probe;
mod provenance;
mod report;
mod schema;
mod simulated;
mod structures;
mod studio;
mod uncertainty;
mod units;
mod whole_way;
mod width;
mod wrong_files;
mod wrong_input;

use std::process::{Command, Output};

use serde_json::Value;
pub(crate) use volcomp_test_support::root;

/// Runs `volcomp` in the repository's root.
pub(crate) fn volcomp(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volcomp"))
        .args(arguments)
        .current_dir(root())
        .output()
        .expect("the program was built for this test")
}

/// The words of a call as it is typed.
pub(crate) fn words(call: &str) -> Vec<&str> {
    call.split(' ').collect()
}

/// The JSON document of a call that must succeed.
pub(crate) fn json(arguments: &[&str]) -> Value {
    let output = volcomp(&[&["--json"], arguments].concat());
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(is_done(arguments, &output), "{arguments:?}: {stderr}");
    serde_json::from_slice(&output.stdout).expect("one JSON document")
}

/// Status 0, or 3 where the call states a tolerance, which may not be met.
fn is_done(arguments: &[&str], output: &std::process::Output) -> bool {
    let states_tolerance = arguments.contains(&"--tolerance");
    output.status.code() == Some(0) || states_tolerance && output.status.code() == Some(3)
}

/// The text for people of a call that must succeed.
pub(crate) fn text(arguments: &[&str]) -> String {
    let output = volcomp(arguments);
    assert!(is_done(arguments, &output), "{arguments:?}");
    String::from_utf8(output.stdout).expect("UTF-8")
}

/// The message of a call that must be refused: status 2, nothing on standard output.
pub(crate) fn refused(arguments: &[&str]) -> String {
    let output = volcomp(arguments);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {stderr}");
    assert!(
        output.stdout.is_empty(),
        "{arguments:?} printed on standard output"
    );
    assert!(!stderr.contains("panicked"), "{stderr}");
    stderr
}
