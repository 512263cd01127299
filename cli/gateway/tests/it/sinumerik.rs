//! The gateway on a simulated SINUMERIK control, an OPC UA server based on another library. Thermal drift is corrected,
//! and faults of the control are detected.

use std::{
    io::{BufRead as _, BufReader, Write as _},
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    process::{ChildStdout, Command, Stdio},
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_test_support::{Running, peers, root};

use crate::{
    check::check,
    program::{Program, change, path, token_file},
};

/// Timeout of all waits; long enough for a busy computer. A cycle takes 100 ms, and the correction of the drift some
/// seconds.
const PATIENCE: Duration = Duration::from_secs(90);

/// X and Y expand with the bed. The model also has a geometric error, which this path must not correct.
const MACHINE: &str = r#"
name = "mill"
structure = "w b X Y Z t"
[axes.X]
travel = [0.0, 800.0]
[axes.Y]
travel = [0.0, 400.0]
[axes.Z]
travel = [0.0, 250.0]
[errors]
EYY = 25.0
EZZ = { poly = [0.0, 0.1] }
[[thermal.drift]]
error = "EXX"
sensors = { bed = 1.0 }
um_per_k = 7.5
[[thermal.drift]]
error = "EYY"
sensors = { bed = 1.0 }
um_per_k = -2.5
"#;

struct Control {
    running: Running,
    output: BufReader<ChildStdout>,
    url: String,
}

impl Control {
    fn start(dir: &Path, arguments: &[&str]) -> Option<Self> {
        let python = peers::python()?;
        let machine = dir.join("machine.toml");
        std::fs::write(&machine, MACHINE).expect("writable");
        let mut command = Command::new(python);
        command
            .arg(root().join("drivers/sinumerik/tests/peer/sinumerik-sim.py"))
            .args(["--listen", "127.0.0.1:0", "--json", "--truth", path(&machine)])
            // Axis positions do not affect thermal corrections.
            .args(["--at", "X=400,Y=150,Z=50", "--stroke-mm", "60", "--period-s", "4"])
            .args(["--temperature", "bed=20", "--user", "gateway:opc-ua-secret"])
            .args(arguments)
            .stdin(Stdio::piped());
        let (running, line, output) = Running::start_and_hear(&mut command);
        let url = line.strip_prefix("listening on ");
        let url = url.unwrap_or_else(|| panic!("found {line:?}")).to_owned();
        Some(Self { running, output, url })
    }

    fn type_in(&mut self, command: &str) {
        let input = self.running.stdin.as_mut().expect("piped");
        writeln!(input, "{command}").expect("it runs");
    }

    fn report(&mut self) -> Value {
        self.type_in("report");
        let mut line = String::new();
        self.output.read_line(&mut line).expect("a line");
        serde_json::from_str(&line).expect("JSON")
    }

    fn um(&mut self, key: &str, axis: &str) -> f64 {
        self.report()[key][axis].as_f64().expect("a number")
    }

    fn wait(&mut self, program: &Program, what: &str, done: impl Fn(&Value) -> bool) {
        let end = Instant::now() + PATIENCE;
        loop {
            let report = self.report();
            if done(&report) {
                return;
            }
            let reported = || format!("{what}: {report}\n{}\n{}", program.state(), program.log());
            assert!(Instant::now() < end, "{}", reported());
            std::thread::sleep(Duration::from_millis(100));
        }
    }
}

fn configuration(dir: &Path, control: &Control) -> PathBuf {
    token_file(dir);
    let password = dir.join("password");
    std::fs::write(&password, "opc-ua-secret\n").expect("writable");
    std::fs::set_permissions(&password, std::fs::Permissions::from_mode(0o600)).expect("ours");
    let url = &control.url;
    let text = format!(
        r#"
machine = "machine.toml"
cycle_ms = 100.0
[guard]
limit_um = 40.0
limit_without_barrier_um = 40.0
slew_um_per_s = 100.0
hold_ms = 200
zero_after_ms = 6000
ramp_s = 2.0
confirm_um = 100.0
# The axes move all the time.
test_shift_um = 0
# A temperature is set to another one at once.
max_degc_per_min = 1000.0
[[controller]]
url = "{url}"
axes = ["X", "Y", "Z"]
terms = ["thermal"]
hold_ms = 4000
unwatched = true
[controller.sinumerik]
user = "gateway"
password_file = "password"
time_out_ms = 2000
[controller.sinumerik.nodes]
emergency_stop = "/Plc/DB10.DBX106.1"
alarm = "/Plc/DB10.DBX109.0"
referenced = "/Plc/DB{{db}}.DBX60.4"
[[thermometer]]
url = "{url}"
names = ["bed"]
nodes = ["/Plc/DB5.DBD0:REAL"]
[thermometer.sinumerik]
user = "gateway"
password_file = "password"
time_out_ms = 2000
[dashboard]
token_file = "tokens"
"#
    );
    let file = dir.join("G.toml");
    std::fs::write(&file, text).expect("writable");
    file
}

fn wait(program: &Program, what: &str, done: impl Fn(&Value) -> bool) -> Value {
    let end = Instant::now() + PATIENCE;
    loop {
        let state = program.state();
        if done(&state) {
            return state;
        }
        assert!(Instant::now() < end, "{what}: {state}\n{}", program.log());
        std::thread::sleep(Duration::from_millis(100));
    }
}

fn is(name: &str) -> impl Fn(&Value) -> bool {
    move |state| state["state"] == name
}

fn is_zero(report: &Value) -> bool {
    ["X", "Y", "Z"].iter().all(|axis| report["setting_um"][axis] == 0.0)
}

fn armed(dir: &Path, config: &Path) -> Program {
    let program = Program::start(dir, &["--config", path(config)]);
    wait(&program, "it has watched", |state| {
        !state["reasons"].to_string().contains("watching") && state["state"] == "disarmed"
    });
    // Arming may be forbidden until the first temperatures and readings.
    let end = Instant::now() + PATIENCE;
    loop {
        let answer = program.post("/api/arm", "");
        if answer.status < 300 {
            break;
        }
        assert!(Instant::now() < end, "{}\n{}", answer.body, program.log());
        std::thread::sleep(Duration::from_millis(200));
    }
    wait(&program, "it compensates", is("compensating"));
    program
}

#[test]
fn thirty_micrometres_of_drift_are_removed_and_geometry_is_left_alone() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(mut control) = Control::start(dir.path(), &[]) else {
        return;
    };
    let config = configuration(dir.path(), &control);
    let (text, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 0, "{errors}");
    for part in ["terms = [\"thermal\"]", "# fastest_per_min = { X = 100.0", "period_ms = 100.0"] {
        assert!(text.contains(part), "{part}: {text}");
    }
    assert!(!text.contains("opc-ua-secret"), "{text}");
    let (json, ..) = check(&config, &["--online", "--json"]);
    crate::interop::validate("gateway-check.json", &serde_json::from_str(&json).expect("JSON"));

    let program = armed(dir.path(), &config);
    // At the reference temperature there is no correction, although the machine file has geometric errors.
    assert!(is_zero(&control.report()));
    control.type_in("temperature bed=24");
    control.wait(&program, "the drift is removed", |report| {
        let um = |key: &str, axis: &str| report[key][axis].as_f64().expect("a number");
        um("drift_um", "X") == 30.0
            && um("residual_um", "X").abs() < 3.0
            && um("residual_um", "Y").abs() < 3.0
    });
    assert_eq!(control.um("drift_um", "Y"), -10.0);
    assert_eq!(control.um("setting_um", "Z"), 0.0);
    let state = program.state();
    assert!(state["reasons"].to_string().contains("no barrier"), "{state}");

    assert!(program.post("/api/disarm", "").status < 300);
    control.wait(&program, "it went back", is_zero);
}

#[test]
fn a_control_that_ignores_corrections_is_refused() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(control) = Control::start(dir.path(), &["--md32750", "2"]) else {
        return;
    };
    let config = configuration(dir.path(), &control);
    let (_, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 1, "{errors}");
    assert!(
        errors.contains("MD32750 $MA_TEMP_COMP_TYPE is 2; expected bit 0 set (1 or 3): the control ignores SD43900"),
        "{errors}"
    );
}

#[test]
fn configurations_that_this_control_cannot_have() {
    let dir = tempfile::tempdir().expect("writable");
    let Some(control) = Control::start(dir.path(), &[]) else {
        return;
    };
    let refused = |from: &str, to: &str| {
        let config = configuration(dir.path(), &control);
        change(&config, from, to);
        let (_, errors, status) = check(&config, &[]);
        assert_eq!(status, 2, "{to}: {errors}");
        errors
    };
    let errors = refused("terms = [\"thermal\"]\nhold_ms = 4000\n", "");
    assert!(
        errors.contains("every 100 ms, and at 10 m/min an axis is 16.7 mm further by then"),
        "{errors}"
    );
    let errors = refused("hold_ms = 4000", "hold_ms = 250");
    assert!(errors.contains("found 250, expected 300 to 5000"), "{errors}");
    let errors = refused("cycle_ms = 100.0", "cycle_ms = 50.0");
    assert!(errors.contains("100 ms"), "{errors}");
    let errors = refused("unwatched = true\n", "");
    assert!(errors.contains("unwatched"), "{errors}");
    let errors = refused("user = \"gateway\"\n", "");
    assert!(errors.contains("expected both or neither"), "{errors}");
    let errors = refused("time_out_ms = 2000", "period_ms = 50");
    assert!(errors.contains("period_ms"), "{errors}");
    let errors = refused("nodes = [\"/Plc/DB5.DBD0:REAL\"]", "nodes = []");
    assert!(errors.contains("found 0 nodes for 1 names"), "{errors}");
    let errors = refused("{db}.DBX60.4", ".DBX60.4");
    assert!(errors.contains("nodes.referenced"), "{errors}");
    let config = configuration(dir.path(), &control);
    let password = dir.path().join("password");
    std::fs::set_permissions(&password, std::fs::Permissions::from_mode(0o644)).expect("ours");
    let (_, errors, status) = check(&config, &[]);
    assert_eq!(status, 2, "{errors}");
    assert!(errors.contains("found mode 644, expected 600"), "{errors}");
}
