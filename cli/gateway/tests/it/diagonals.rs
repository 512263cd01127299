//! Body diagonals end to end: the simulated control measures the residual of its true errors at its targets, with a right, a wrong, a
//! limited and a missing correction.

use std::{
    fs,
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{ChildStdout, Command, Stdio},
    time::Duration,
};

use serde_json::Value;
use volcomp_test_support::{Running, until};

use crate::{
    program::{Program, path},
    shipped::simulator,
};

const PATIENCE: Duration = Duration::from_secs(120);

/// Range of each diagonal without and with correction, µm.
type Ranges = Vec<[f64; 2]>;

/// A machine of 400 × 300 × 200 mm with scale errors of 200 µm/m and more: up to 90 µm at the ends.
fn machine() -> String {
    let [x, y, z, square] = [0.2, 0.15, 0.25, 80.0];
    format!(
        "name = \"small\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 400.0]\n[axes.Y]\ntravel = [0.0, 300.0]\n\
         [axes.Z]\ntravel = [0.0, 200.0]\n[errors]\nEXX = {{ poly = [0.0, {x}] }}\nEYY = {{ poly = [0.0, {y}] }}\n\
         EZZ = {{ poly = [0.0, {z}] }}\nEC0Y = {square}\n"
    )
}

fn diagonals() -> String {
    let row = |name: &str, share: f64| {
        let at = |(sense, length): (char, f64)| {
            let share = if sense == 'P' { share } else { 1.0 - share };
            (share * length).to_string()
        };
        let at: Vec<String> = name.chars().zip([400.0, 300.0, 200.0]).map(at).collect();
        format!("{name},{},60000", at.join(","))
    };
    let mut rows = vec![
        "line,X,Y,Z,feed".to_owned(),
        ",200,150,100,60000".to_owned(),
    ];
    for name in ["PPP", "NPP", "PNP", "PPN"] {
        rows.extend([0.0, 0.25, 0.5, 0.75, 1.0].map(|share| row(name, share)));
    }
    rows.join("\n")
}

/// A simulated control that waits for a start command, and a gateway that corrects it.
struct Rig {
    dir: tempfile::TempDir,
    control: Running,
    output: BufReader<ChildStdout>,
    gateway: Program,
}

const BARRIER: &str = "barrier = { frame = { pmc = \"R\", at = 200 }, report = { pmc = \"R\", at = 240 }, machine = 1, scan_ms = 8.0 }";

impl Rig {
    /// `model` is the gateway's machine file; `way` the lines of its `[[controller]]` table that concern writing.
    fn start(model: &str, way: &str, of_control: &[&str]) -> Self {
        let dir = tempfile::tempdir().expect("writable");
        let file = |name: &str, text: &str| {
            fs::write(dir.path().join(name), text).expect("writable");
        };
        file("truth.toml", &machine());
        file("machine.toml", model);
        file("diagonals.csv", &diagonals());
        let arguments = [
            "--listen",
            "127.0.0.1:0",
            "--truth",
            "truth.toml",
            "--program",
            "diagonals.csv",
            "--acceleration-mm-s2",
            "5000",
            "--report",
            "targets.csv",
            "--wait",
            "--report-s",
            "0",
            "--settle-s",
            "0.4",
            // A scan that a busy computer can keep.
            "--scan-ms",
            "8",
            "--json",
        ];
        let (control, line, output) = Running::start_and_hear(
            Command::new(simulator())
                .args(arguments)
                .args(of_control)
                .current_dir(dir.path())
                .stdin(Stdio::piped()),
        );
        let address = line.strip_prefix("listening on ").expect("an address");
        let configuration = format!(
            "machine = \"machine.toml\"\ncycle_ms = 4.0\nauto_arm = true\n[guard]\nlimit_um = 150.0\nslew_um_per_s = 500.0\n\
             hold_ms = 200\nzero_after_ms = 2000\nramp_s = 0.1\ntest_shift_um = 0\n[[controller]]\nurl = \"focas://{address}\"\naxes = [\"X\", \"Y\", \"Z\"]\n\
             includes_correction = true\n{way}\n[audit]\ndir = \"audit\"\n"
        );
        file("gateway.toml", &configuration);
        let gateway = dir.path().join("gateway.toml");
        let gateway = Program::start(dir.path(), &["--config", path(&gateway)]);
        gateway.wait_for("compensating");
        Self {
            dir,
            control,
            output,
            gateway,
        }
    }

    fn type_line(&mut self, line: &str) {
        writeln!(self.control.stdin.as_mut().expect("piped"), "{line}").expect("it listens");
    }

    fn document(&mut self) -> Value {
        let mut line = String::new();
        self.output.read_line(&mut line).expect("text");
        serde_json::from_str(&line).expect("JSON")
    }

    /// Ranges of the diagonals in one pass through the program.
    fn ranges(&mut self) -> Ranges {
        let pass = self.document();
        assert_eq!(pass["not_settled"], 0, "{pass}");
        let lines = pass["lines"].as_array().expect("lines");
        let of = |line: &Value| {
            assert_eq!(line["targets"], 5);
            ["range_without_um", "range_um"].map(|name| line[name].as_f64().expect("a number"))
        };
        let ranges: Ranges = lines.iter().map(of).collect();
        assert_eq!(ranges.len(), 4, "{pass}");
        ranges
    }

    fn targets(&self) -> Vec<Target> {
        targets(&self.dir.path().join("targets.csv"))
    }
}

/// A row of the results table, µm: corrections of the axes, and tip error without and with them.
#[derive(Debug, PartialEq)]
struct Target {
    correction: [f64; 3],
    error: [f64; 3],
    residual: [f64; 3],
}

fn targets(file: &Path) -> Vec<Target> {
    let text = fs::read_to_string(file).unwrap_or_default();
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let of = |name: &str| {
            let place = head.iter().position(|found| *found == name);
            cells[place.expect("a column")].parse().expect("a number")
        };
        Target {
            correction: ["X_um", "Y_um", "Z_um"].map(of),
            error: ["error_x_um", "error_y_um", "error_z_um"].map(of),
            residual: ["residual_x_um", "residual_y_um", "residual_z_um"].map(of),
        }
    };
    lines.map(row).collect()
}

/// The right model reduces each range by at least 90 %. The remaining tip error is at most 0.62 µm per axis, the rounding of the output
/// words.
#[test]
fn ranges_fall_by_nine_tenths() {
    let mut rig = Rig::start(&machine(), BARRIER, &[]);
    rig.type_line("run");
    for [without, with] in rig.ranges() {
        assert!(without > 30.0, "{without} µm");
        assert!(with <= 0.1 * without, "{without} → {with} µm");
    }
    for target in rig.targets() {
        for part in target.residual {
            // Half an output step, 10 % hysteresis, and 0.02 µm because the error is evaluated at the corrected position.
            assert!(part.abs() <= 0.62, "{target:?}");
        }
    }
}

/// Without a barrier no output word exceeds 30 µm, whatever the limit; the table lists the residual that remains.
#[test]
fn without_a_barrier_words_end_at_thirty_micrometres() {
    let plain = "area = { pmc = \"R\", first = 100, width = 2 }\nunwatched = true";
    let mut rig = Rig::start(&machine(), plain, &["--no-barrier"]);
    rig.type_line("run");
    let ranges = rig.ranges();
    assert!(
        ranges.iter().any(|[without, with]| *with > 0.1 * without),
        "{ranges:?}"
    );
    let targets = rig.targets();
    let furthest = targets.iter().flat_map(|target| target.correction);
    let furthest = furthest.map(f64::abs).fold(0.0, f64::max);
    assert_eq!(furthest, 30.0);
    for target in &targets {
        for axis in 0..3 {
            // The axes of this machine carry the workpiece: residual = error + applied correction.
            let left = target.error[axis] + target.correction[axis];
            assert!((target.residual[axis] - left).abs() < 0.05, "{target:?}");
        }
    }
}

/// The gateway is killed while the machine moves: the barrier ramps the correction to zero, and later targets show no correction and the
/// full tip error.
#[test]
fn a_gateway_that_is_killed_leaves_no_correction() {
    let mut rig = Rig::start(&machine(), BARRIER, &[]);
    rig.type_line("run");
    until("eight targets", PATIENCE, || rig.targets().len() >= 8);
    rig.gateway.running.kill();
    let before = rig.targets().len();
    for [without, with] in rig.ranges().into_iter().skip(3) {
        assert_eq!(without, with);
    }
    let targets = rig.targets();
    assert_eq!(targets.len(), 20);
    let off = |parts: [f64; 3]| parts.into_iter().map(f64::abs).fold(0.0, f64::max);
    // The first target after the kill may have been measured before the kill and written after it.
    for target in &targets[before + 1..] {
        assert_eq!(target.correction, [0.0; 3], "{target:?}");
        assert_eq!(target.residual, target.error);
    }
    assert!(
        targets[before + 1..]
            .iter()
            .any(|target| off(target.error) > 50.0)
    );
    assert!(
        targets[..before]
            .iter()
            .all(|target| off(target.residual) <= 0.62)
    );
    // The barrier's rate: 1000 µm/s in scans of 8 ms.
    rig.type_line("quit");
    let steps = rig.document();
    for axis in ["X", "Y", "Z"] {
        let step = steps["largest_step_um"][axis].as_f64().expect("a number");
        assert!((1.0..=8.0).contains(&step), "{steps}");
    }
}
