//! The dashboard in a headless Chromium, driven by Playwright.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Command, Stdio},
};

use serde_json::Value;
use volcomp_model::{Machine, Temperatures};
use volcomp_studio::{Folder, Studio};
use volcomp_test_support::peers;
use volcomp_vocabulary::AxisName;

use crate::{
    interop::{closed_address, two_ways},
    manual::{Served, control, served_configuration},
    models::{ENGINEER, engineers, examples, model},
    program::{OPERATE, Program, change, path, token_file},
};

/// Runs a script of this folder in the browser. Calls `then` when the script reports that it is ready.
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

/// Operates the built-in simulation, which accepts no model, and checks the page while the program ends.
#[test]
fn a_person_sees_and_operates_it() {
    let dir = tempfile::tempdir().expect("writable");
    token_file(dir.path());
    engineers(dir.path());
    let tokens = dir.path().join("tokens");
    let audit = dir.path().join("audit");
    let arguments = ["--simulate", "--token-file", path(&tokens), "--audit-dir"];
    let mut program = Program::start(dir.path(), &[&arguments[..], &[path(&audit)]].concat());
    let url = format!("http://{}/", program.address);
    let page = "gateway-built-in.png";
    run("browser_built_in.py", &[&url, ENGINEER], page, || {});
    run("browser.py", &[&url, OPERATE], "gateway.png", || {
        program.signal("TERM");
        assert_eq!(program.end(), Some(0), "{}", program.log());
    });
}

#[test]
fn a_person_sees_what_is_missing_and_what_is_not_known() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control();
    let config = two_ways(dir.path(), &control, &closed_address());
    change(&config, "token_file = \"tokens\"\n", "");
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let url = format!("http://{}/", program.address);
    run("browser_paths.py", &[&url], "gateway-paths.png", || {
        drop(control);
    });
}

/// The studio creates a machine file from a folder of laser files. An engineer activates the file in the gateway, which
/// then corrects with it.
#[test]
fn an_engineer_brings_measurements_from_the_studio_into_force() {
    let dir = tempfile::tempdir().expect("writable");
    let config = served_configuration(dir.path(), "auto_arm = true");
    let machine = std::fs::read_to_string(examples().join("machine.toml")).expect("there");
    std::fs::write(dir.path().join("machine.toml"), machine).expect("writable");
    engineers(dir.path());
    // The threshold is so small that the model of the example needs a confirmation.
    change(&config, "confirm_um = 10.0", "confirm_um = 1.0");
    let program = Served::start(&config);
    program.wait_for("compensating");
    let gateway = format!("http://{}/", program.address);
    let measured = tempfile::tempdir().expect("writable");
    let folder = Folder::open(measured.path()).expect("a folder");
    let studio = Studio::listen(folder, "127.0.0.1:0".parse().expect("an address"));
    let studio = studio.expect("a free port");
    let page = studio.url();
    // The studio serves until the test program ends.
    std::thread::spawn(move || studio.run());
    let lasers = examples();
    let arguments = [page.as_str(), &gateway, ENGINEER, path(&lasers)];
    run("browser_studio.py", &arguments, "studio.png", || {});
    let result = measured.path().join("result/machine.toml");
    let Ok(machine) = Machine::read(&result) else {
        // No browser is installed; `run` has reported that.
        return;
    };
    assert_eq!(model(&program)["hash"], machine.checksum().as_str());
    program
        .wait(|state| state["state"] == "compensating" && corrects_as(&machine, state))
        .unwrap_or_else(|state| panic!("another correction: {state}"));
}

/// True if the published correction (about 10 µm) equals that of `machine` at the published position within 1.5 µm: one
/// output step plus half a step of motion between two cycles.
fn corrects_as(machine: &Machine, state: &Value) -> bool {
    let at = |list: &str, axis: AxisName| state[list][axis.to_string()].as_f64();
    let axes = [AxisName::X, AxisName::Y, AxisName::Z];
    let position: Option<Vec<(AxisName, f64)>> =
        axes.iter().map(|axis| Some((*axis, at("positions_mm", *axis)?))).collect();
    let Some(position) = position else {
        return false;
    };
    let pose = machine.state(&position).expect("its axes");
    let options = machine.correction_options();
    let found = machine.correction_at(&pose, &Temperatures::new(), &options);
    axes.iter().all(|axis| {
        let place = machine.index_of(*axis).expect("its axis");
        let expected_um = 1e3 * found.delta[place];
        at("correction_um", *axis).is_some_and(|um| (um - expected_um).abs() < 1.5)
    })
}
