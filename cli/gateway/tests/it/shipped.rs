//! The shipped configurations with the simulated control, run by the commands in their comments.

use std::{
    io::BufRead,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    sync::{Arc, Mutex},
};

use serde_json::Value;
use volcomp_test_support::Running;

use crate::program::{Program, change};

/// The simulated control and its latest report line.
struct Control {
    _running: Running,
    address: String,
    report: Arc<Mutex<Option<Value>>>,
}

impl Control {
    fn start(folder: &Path, arguments: &[&str]) -> Self {
        let (running, line, output) = Running::start_and_hear(
            Command::new(simulator())
                .args(arguments)
                .args(["--listen", "127.0.0.1:0", "--json", "--report-s", "0.1"])
                .current_dir(folder)
                .stdin(Stdio::null()),
        );
        let address = line.strip_prefix("listening on ");
        let address = address.unwrap_or_else(|| panic!("it says {line:?}"));
        let report = Arc::default();
        let control =
            Self { _running: running, address: address.to_owned(), report: Arc::clone(&report) };
        std::thread::spawn(move || {
            for line in output.lines().map_while(Result::ok) {
                let found = serde_json::from_str(&line).ok();
                *report.lock().expect("no panic") = found;
            }
        });
        control
    }

    fn report(&self) -> Option<Value> {
        self.report.lock().expect("no panic").clone()
    }

    /// Tool error without and with the correction, µm.
    fn misses_um(&self) -> Option<[f64; 2]> {
        let report = self.report()?;
        let length = |name: &str| {
            let vector = report[name]["position_um"].as_array()?;
            let squares = vector.iter().map(|x| x.as_f64().map(|x| x * x));
            squares.sum::<Option<f64>>().map(f64::sqrt)
        };
        Some([length("error")?, length("residual")?])
    }
}

/// Path of the simulator in the folder of the tested gateway. The simulator is built if it is missing.
pub(crate) fn simulator() -> PathBuf {
    let gateway = Path::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    let folder = gateway.parent().expect("a folder");
    let simulator = folder.join("focas-sim");
    if !simulator.is_file() {
        let profile = match folder.file_name().and_then(|name| name.to_str()) {
            Some("debug") | None => "dev",
            Some(name) => name,
        };
        let built = Command::new(env!("CARGO"))
            .args(["build", "--locked", "-p", "focas-sim", "--profile", profile])
            .env("CARGO_TARGET_DIR", folder.parent().expect("a folder"))
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .status();
        assert!(built.is_ok_and(|status| status.success()));
    }
    simulator
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../..")
}

/// Arguments of the first command `cargo run --bin PROGRAM -- …` in the comments of a configuration.
fn arguments<'a>(text: &'a str, program: &str) -> Vec<&'a str> {
    let begins = format!("#     cargo run --bin {program} -- ");
    let command = text.lines().find_map(|line| line.strip_prefix(&begins));
    let command = command.unwrap_or_else(|| panic!("no line begins with {begins}"));
    command.split_whitespace().collect()
}

pub(crate) fn copied_examples() -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().expect("writable");
    let examples = dir.path().join("examples");
    std::fs::create_dir(&examples).expect("writable");
    for entry in std::fs::read_dir(root().join("examples")).expect("there") {
        let file = entry.expect("readable").path();
        if file.is_file() {
            let copy = examples.join(file.file_name().expect("a name"));
            std::fs::copy(&file, copy).expect("writable");
        }
    }
    (dir, examples)
}

/// Runs both programs by the commands in the comments of the configuration, on free ports. The residual must be below a
/// fifth of the error.
fn rehearse(configuration: &str) {
    let (dir, examples) = copied_examples();
    let file = examples.join(configuration);
    let text = std::fs::read_to_string(&file).expect("readable");
    let control = Control::start(dir.path(), &arguments(&text, "focas-sim"));
    change(&file, "127.0.0.1:8193", &control.address);
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command.current_dir(dir.path());
    let gateway = Program::spawn(command, dir.path(), &arguments(&text, "volcomp-gateway"));
    gateway.wait_for("compensating");
    let seen = Mutex::new(Vec::new());
    let reached = gateway.wait(|_| {
        let Some(misses) = control.misses_um() else {
            return false;
        };
        seen.lock().expect("no panic").push(misses);
        // The comparison needs a position with a large error.
        misses[0] > 20.0 && misses[1] < 0.2 * misses[0]
    });
    assert!(reached.is_ok(), "µm without and with correction: {seen:?}\n{}", gateway.log());
}

#[test]
fn three_axes_as_shipped() {
    rehearse("gateway.toml");
}

#[test]
fn five_axes_as_shipped() {
    rehearse("gateway-five-axis.toml");
}
