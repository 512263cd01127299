//! The dashboard in a headless Chromium, by Playwright.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Command, Stdio},
};

use volcomp_test_support::peers;

use crate::{
    controlled::control,
    models::{ENGINEER, engineers, examples, measured_control, measured_rig_in},
    paths::{nobody, two_ways},
    program::{OPERATE, Program, change, path, token_file},
};

/// Runs a script of this folder in the browser; `then` is called when it says that it is ready.
fn run(script: &str, arguments: &[&str], screenshot: &str, then: impl FnOnce()) {
    if !Path::new("/usr/bin/chromium").exists() {
        peers::not_run("Chromium");
        return;
    }
    let Some(python) = peers::python() else {
        return;
    };
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut browser = Command::new(python)
        .arg(here.join("tests/it").join(script))
        .args(arguments)
        .arg(here.join("../../target").join(screenshot))
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("Python");
    let mut lines = BufReader::new(browser.stdout.take().expect("piped")).lines();
    let said = lines.next().and_then(Result::ok);
    if said.as_deref() == Some("ready") {
        then();
        writeln!(browser.stdin.take().expect("piped"), "gone").expect("it listens");
    }
    let output = browser.wait_with_output().expect("ours");
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{message}");
}

#[test]
fn a_person_sees_and_operates_it() {
    let dir = tempfile::tempdir().expect("writable");
    let mut program = Program::simulated(dir.path());
    let url = format!("http://{}/", program.address);
    run("browser.py", &[&url, OPERATE], "gateway.png", || {
        program.signal("TERM");
        assert_eq!(program.end(), Some(0), "{}", program.log());
    });
}

#[test]
fn a_person_sees_that_the_built_in_simulation_takes_no_model() {
    let dir = tempfile::tempdir().expect("writable");
    let tokens = token_file(dir.path());
    engineers(dir.path());
    let audit = dir.path().join("audit");
    let arguments = ["--simulate", "--token-file", path(&tokens), "--audit-dir"];
    let program = Program::start(dir.path(), &[&arguments[..], &[path(&audit)]].concat());
    let url = format!("http://{}/", program.address);
    run(
        "browser_built_in.py",
        &[&url, ENGINEER],
        "gateway-built-in.png",
        || {},
    );
}

#[test]
fn a_person_sees_what_is_missing_and_what_is_not_known() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = two_ways(dir.path(), &control, &nobody());
    change(&config, "token_file = \"tokens\"\n", "");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let url = format!("http://{}/", program.address);
    run("browser_paths.py", &[&url], "gateway-paths.png", || {
        drop(control);
    });
}

#[test]
fn a_person_makes_a_model_from_measurements() {
    let dir = tempfile::tempdir().expect("writable");
    let control = measured_control();
    let config = measured_rig_in(dir.path(), &control);
    // Small enough that the model of the example is asked about.
    change(&config, "confirm_um = 10.0", "confirm_um = 1.0");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    program.wait_for("compensating");
    let url = format!("http://{}/", program.address);
    let folder = examples();
    let arguments = [url.as_str(), ENGINEER, path(&folder)];
    run("browser_model.py", &arguments, "gateway-model.png", || {});
}
