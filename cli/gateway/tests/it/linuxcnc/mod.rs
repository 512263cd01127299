//! The gateway on a real headless LinuxCNC. The motion of the motors is compared with the corrections of known errors.

mod key;
mod peer;
mod tables;
mod traps;
mod trunnion;

use std::{
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
};

use peer::{Cycle, LinuxCnc};

use crate::program::{Program, path, token_file};

const PORT: u16 = 47_001;

/// Maximum offset change per cycle of the barrier and of LinuxCNC's planner, mm.
const MOST: f64 = 0.005;

/// A mill with known linear and quadratic errors. X carries the workpiece, Y and Z the tool.
const MACHINE: &str = r#"
name = "mill"
structure = "w X' b Y Z t"
[axes.X]
travel = [-10.0, 500.0]
[axes.Y]
travel = [-10.0, 400.0]
[axes.Z]
travel = [-300.0, 10.0]
[errors]
EXX = { poly = [2.0, 0.03] }
EYX = { poly = [0.0, 0.0, 5e-5] }
EYY = { poly = [0.0, -0.03] }
EZZ = { poly = [0.0, 0.02] }
EZX = { poly = [-3.0, 0.01] }
"#;

/// Corrections of the errors of [`MACHINE`], computed by hand: added motion of each motor, mm.
fn oracle([x, y, z]: [f64; 3]) -> [f64; 3] {
    [
        -(2.0 + 0.03 * x) * 1e-3,
        -(5e-5 * x * x) * 1e-3 + 0.03 * y * 1e-3,
        -(-3.0 + 0.01 * x) * 1e-3 - 0.02 * z * 1e-3,
    ]
}

fn configuration(dir: &Path, port: u16) -> PathBuf {
    configuration_of(dir, port, MACHINE)
}

fn configuration_of(dir: &Path, port: u16, machine: &str) -> PathBuf {
    write_configuration(dir, port, machine, "")
}

fn key_file(dir: &Path) {
    let file = dir.join("volcomp.key");
    std::fs::write(&file, "000102030405060708090a0b0c0d0e0f\n").expect("writable");
    let own = std::fs::Permissions::from_mode(0o600);
    std::fs::set_permissions(file, own).expect("ours");
}

fn write_configuration(dir: &Path, port: u16, machine: &str, more: &str) -> PathBuf {
    std::fs::write(dir.join("machine.toml"), machine).expect("writable");
    token_file(dir);
    key_file(dir);
    let text = format!(
        r#"
machine = "machine.toml"
cycle_ms = 1.0
auto_arm = true
[guard]
limit_um = 30.0
slew_um_per_s = 500.0
hold_ms = 100
zero_after_ms = 1000
ramp_s = 0.3
confirm_um = 100.0
# Tests move the axes at once.
test_shift_um = 0
[[controller]]
url = "linuxcnc://127.0.0.1:{port}"
axes = ["X", "Y", "Z"]
linuxcnc = {{ key_file = "volcomp.key" }}
{more}[controller.barrier]
machine = 1
scan_ms = 1.0
[dashboard]
token_file = "tokens"
"#
    );
    let file = dir.join("G.toml");
    std::fs::write(&file, text).expect("writable");
    file
}

/// A gateway for the bridge at this port, with real-time priority if permitted.
fn gateway(dir: &Path, port: u16) -> Program {
    start(dir, &configuration(dir, port))
}

fn start(dir: &Path, config: &Path) -> Program {
    let program = Program::start(dir, &["--config", path(config)]);
    let pid = program.running.id().to_string();
    let _ = std::process::Command::new("chrt").args(["-a", "-f", "-p", "30", &pid]).output();
    program
}

/// The mill with an edited INI file, and its gateway: switched on, homed, and corrected at this point.
fn corrected_at(point: &str, dir: &Path, edit: impl Fn(String) -> String) -> (LinuxCnc, Program) {
    let mut control = LinuxCnc::start(dir, edit);
    let program = gateway(dir, PORT);
    control.do_it("up");
    control.mdi(&format!("G21 G90 G0 {point}"));
    wait_corrected(&mut control, &program);
    (control, program)
}

/// Sorted distances of the motors from the expected motion, nm. The expected motion is the nominal position plus its
/// correction, both from the earlier cycle whose command the motor executes now (see [`distances`]).
fn residuals(cycles: &[Cycle]) -> Vec<f64> {
    residuals_of(cycles, |at| oracle(at.nominal))
}

fn residuals_of(cycles: &[Cycle], oracle: impl Fn(&Cycle) -> [f64; 3]) -> Vec<f64> {
    distances(cycles, |now, then| {
        let wanted = oracle(then);
        [0, 1, 2].map(|axis| now.motor[axis] - then.nominal[axis] - wanted[axis])
    })
}

/// Sorted distances of the offsets from those expected at the motor positions, nm. Unlike [`residuals`] they exclude
/// LinuxCNC's smoothing of the motion, which is 300 nm during acceleration, with or without a correction.
fn offset_residuals(cycles: &[Cycle]) -> Vec<f64> {
    distances(cycles, |now, then| {
        let wanted = oracle([0, 1, 2].map(|axis| now.motor[axis] - then.offset[axis]));
        [0, 1, 2].map(|axis| then.offset[axis] - wanted[axis])
    })
}

/// Sorted lengths of the difference between a motor's cycle and the cycle of its command, nm. The delay between the two
/// is a constant number of cycles, which this function determines.
fn distances(cycles: &[Cycle], off_mm: impl Fn(&Cycle, &Cycle) -> [f64; 3]) -> Vec<f64> {
    let of = |shift: usize| {
        let pairs = cycles.iter().skip(shift).zip(cycles);
        let length = |off: [f64; 3]| off.iter().map(|mm| mm * mm).sum::<f64>().sqrt() * 1e6;
        let mut found: Vec<f64> = pairs.map(|(now, then)| length(off_mm(now, then))).collect();
        found.sort_by(f64::total_cmp);
        found
    };
    let all = (0..5).map(of);
    all.min_by(|a, b| part(a, 50).total_cmp(&part(b, 50))).expect("some shift")
}

fn part(sorted: &[f64], per_cent: usize) -> f64 {
    assert!(sorted.len() > 100, "{} cycles", sorted.len());
    sorted[sorted.len() * per_cent / 100]
}

/// Checks the median and the 99th percentile of the residuals.
fn corrected(what: &str, cycles: &[Cycle]) {
    corrected_by(what, cycles, |at| oracle(at.nominal));
}

fn corrected_by(what: &str, cycles: &[Cycle], oracle: impl Fn(&Cycle) -> [f64; 3]) {
    let found = residuals_of(cycles, oracle);
    let [median, most] = [50, 99].map(|of| part(&found, of));
    println!("{what}: {} cycles, residual {median:.2} nm median, {most:.1} nm p99", cycles.len());
    assert!(median < 2.0 && most < 200.0, "{what}: {median} nm, {most} nm");
}

fn offsets(control: &mut LinuxCnc) -> [f64; 3] {
    let found = control.get(&["axis.x.eoffset", "axis.y.eoffset", "axis.z.eoffset"]);
    found.try_into().expect("three")
}

fn wait_corrected(control: &mut LinuxCnc, program: &Program) {
    let end = std::time::Instant::now() + std::time::Duration::from_secs(60);
    loop {
        let pins = ["axis.x.pos-cmd", "axis.y.pos-cmd", "axis.z.pos-cmd"];
        let at: [f64; 3] = control.get(&pins).try_into().expect("three");
        let (found, wanted) = (offsets(control), oracle(at));
        if (0..3).all(|axis| (found[axis] - wanted[axis]).abs() < 3e-6) {
            return;
        }
        assert!(
            std::time::Instant::now() < end,
            "at {at:?} offsets {found:?}, wanted {wanted:?}\n{}\n{}\n{}",
            program.state(),
            control.log(),
            program.log()
        );
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
}

fn wait_zero(control: &mut LinuxCnc) {
    for axis in ["x", "y", "z"] {
        control.wait(&format!("axis.{axis}.eoffset"), |value| value.abs() < 1e-7);
    }
}

/// Checks that no motor moves by more than `most`, mm, in a cycle beyond its programmed motion.
fn no_jump(cycles: &[Cycle], most: f64) {
    for pair in cycles.windows(2) {
        for axis in 0..3 {
            let moved = (pair[1].offset[axis] - pair[0].offset[axis]).abs();
            assert!(moved <= most, "{moved} mm in a cycle");
        }
    }
}
