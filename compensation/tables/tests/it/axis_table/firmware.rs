//! Steps and skew for firmware without tables: with the formula of the firmware, a machine with known errors makes a square.

use volcomp_kinematics::Form;
use volcomp_tables::axis_table::{
    Facts, Firmware, LinearSettings, Skew, TableOptions, firmware_loss, linear_settings,
    write_settings,
};
use volcomp_tables::model::{Machine, Temperatures};
use volcomp_tables::vocabulary::{
    AxisName::{self, A, X, Y, Z},
    CorrectionLimit,
};

use super::close;

/// 1.2 mrad, −0.9 mrad and 0.7 mrad of squareness; X moves 0.3 mm/m too far, Y 0.2 mm/m too little, Z 0.5 mm/m too far.
const ERRORS: &str = "EC0Y = 1200.0\nEA0Z = -900.0\nEB0Z = 700.0\n\
    EXX = { poly = [0.0, 0.3] }\nEYY = { poly = [0.0, -0.2] }\nEZZ = { poly = [0.0, 0.5] }\n";

/// A printer: the bed moves along Y, the bridge carries X and Z.
fn machine(errors: &str) -> Machine {
    let text = format!(
        "structure = \"w Y' b X Z t\"\n[axes]\nX.travel = [0.0, 300.0]\nY.travel = [0.0, 300.0]\nZ.travel = [0.0, 300.0]\n[errors]\n{errors}"
    );
    Machine::parse(&text, "m.toml").expect("a machine")
}

fn options() -> TableOptions {
    TableOptions { limit: CorrectionLimit::LARGEST, ..TableOptions::default() }
}

fn settings(machine: &Machine) -> LinearSettings {
    linear_settings(machine, &Temperatures::new(), &options()).expect("settings")
}

fn text(firmware: Firmware, machine: &Machine, now: &[(AxisName, f64)]) -> String {
    let facts = Facts::of(machine, Vec::new(), String::new());
    let written = write_settings(firmware, &settings(machine), machine, &facts, now);
    let files = written.expect("written").files;
    assert_eq!(files.len(), 1);
    files[0].text.clone()
}

/// The number after `key` in the file.
fn number(text: &str, key: &str) -> f64 {
    let (_, rest) = text.split_once(key).unwrap_or_else(|| panic!("{key} in {text}"));
    let end = rest.find([' ', '\n', ',']).unwrap_or(rest.len());
    rest[..end].parse().unwrap_or_else(|_| panic!("{key} in {text}"))
}

/// Position of the tool after the firmware has moved the motors, by the exact model, mm.
fn tip(machine: &Machine, motors: [f64; 3]) -> [f64; 3] {
    let state = machine.state(&[(X, motors[0]), (Y, motors[1]), (Z, motors[2])]).expect("a state");
    let error = machine.error_at(&state, Form::Exact, &Temperatures::new()).position_mm;
    core::array::from_fn(|at| motors[at] + error[at])
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    core::array::from_fn(|at| a[at] - b[at])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|at| a[at] * b[at]).sum()
}

/// Asserts that the sides of a cube of 200 mm are at right angles within 1 µrad, and 200 mm long within 0.1 µm.
fn is_a_cube(tip_of: impl Fn([f64; 3]) -> [f64; 3]) {
    let corner = tip_of([50.0, 40.0, 30.0]);
    let sides = [[250.0, 40.0, 30.0], [50.0, 240.0, 30.0], [50.0, 40.0, 230.0]]
        .map(|at| minus(tip_of(at), corner));
    for side in sides {
        close(dot(side, side).sqrt(), 200.0, 1e-4);
    }
    for (a, b) in [(0, 1), (0, 2), (1, 2)] {
        close(dot(sides[a], sides[b]) / 200.0 / 200.0, 0.0, 1e-6);
    }
}

/// Position sent to the motors by `skew_correction.py` and `planner.h`, mm.
fn skewed([x, y, z]: [f64; 3], [xy, xz, yz]: [f64; 3]) -> [f64; 3] {
    [x - y * xy - z * (xz - xy * yz), y - z * yz, z]
}

#[test]
fn marlin_makes_a_cube() {
    let machine = machine(ERRORS);
    let file = text(Firmware::Marlin, &machine, &[(X, 80.0), (Y, 100.0), (Z, 400.0)]);
    let skew = [" I", " J", " K"].map(|key| number(&file, key));
    let steps = ["M92 X", "M92 Y", "M92 Z"].map(|key| number(&file, key));
    is_a_cube(|at| {
        let [x, y, z] = skewed(at, skew);
        // Travel of each motor: the steps by the new setting, at the steps per mm that were set before.
        let travel = [x * steps[0] / 80.0, y * steps[1] / 100.0, z * steps[2] / 400.0];
        tip(&machine, travel)
    });
}

#[test]
fn klipper_makes_a_cube_by_profile_and_by_lengths() {
    let machine = machine(ERRORS);
    let file = text(Firmware::Klipper, &machine, &[(X, 40.0), (Y, 40.0), (Z, 8.0)]);
    let profile = ["xy_skew = ", "xz_skew = ", "yz_skew = "].map(|key| number(&file, key));
    let distance = ["x]: ", "y]: ", "z]: "].map(|key| number(&file, key));
    // Skew factor from three lengths, computed as in `SET_SKEW`.
    let (_, lengths) = file.split_once("SET_SKEW ").expect("a command");
    let lengths = lengths.lines().next().expect("a line");
    let of_lengths: Vec<f64> = lengths
        .split_whitespace()
        .map(|word| {
            let of = word[3..].split(',').map(|text| text.parse::<f64>().expect("a length"));
            let [ac, bd, ad] = of.collect::<Vec<_>>()[..] else { panic!("{word}") };
            let ab = (2.0 * ac * ac + 2.0 * bd * bd - 4.0 * ad * ad).sqrt() / 2.0;
            let angle = ((ac * ac - ab * ab - ad * ad) / (2.0 * ab * ad)).acos();
            (core::f64::consts::FRAC_PI_2 - angle).tan()
        })
        .collect();
    for skew in [profile, [of_lengths[0], of_lengths[1], of_lengths[2]]] {
        is_a_cube(|at| {
            let [x, y, z] = skewed(at, skew);
            // A turn of the motor travels 40 mm (Z: 8 mm), but the firmware now assumes the corrected distance.
            let travel = [x * 40.0 / distance[0], y * 40.0 / distance[1], z * 8.0 / distance[2]];
            tip(&machine, travel)
        });
    }
}

/// A travel that ends shortly behind a node, where the correction leaves the range of the curves: the node beyond is extrapolated from there.
#[test]
fn a_travel_that_ends_shortly_behind_a_node_changes_nothing() {
    let short = "EXX = { poly = [0.0, -1.0] }\nEXY = { poly = [0.0, 0.5] }\nEYY = { poly = [0.0, -1.0] }\n\
        EYZ = { poly = [0.0, 0.5] }\nEZZ = { poly = [0.0, -1.0] }\n";
    let of = |travel: f64| {
        let text = format!(
            "structure = \"w Y' b X Z t\"\n[axes]\nX.travel = [0.0, {travel}]\nY.travel = [0.0, {travel}]\nZ.travel = [0.0, {travel}]\n[errors]\n{short}"
        );
        settings(&Machine::parse(&text, "m.toml").expect("a machine"))
    };
    let (whole, longer) = (of(350.0), of(300.1));
    for (one, other) in longer.steps.into_iter().zip(whole.steps) {
        close(one, other, 1e-6);
    }
    for ((_, one), (_, other)) in longer.skew.planes().into_iter().zip(whole.skew.planes()) {
        close(one, other, 1e-6);
    }
}

/// Y leans to +X by tan(1.2 mrad): the factor is positive, and the long diagonal is AC.
#[test]
fn signs() {
    let leaning = settings(&machine("EC0Y = -1200.0\n"));
    close(leaning.skew.xy, 0.0012, 1e-8);
    assert_eq!([leaning.skew.xz, leaning.skew.yz], [0.0, 0.0]);
    close(settings(&machine("EB0Z = 700.0\n")).skew.xz, 0.0007, 1e-8);
    close(settings(&machine("EA0Z = -900.0\n")).skew.yz, 0.0009, 1e-8);
    // X moves 0.3 mm/m too far, so it needs fewer steps, or a longer rotation distance.
    let file = |firmware| text(firmware, &machine("EXX = { poly = [0.0, 0.3] }\n"), &[]);
    close(number(&file(Firmware::Grbl), "; $100: multiply by "), 1.0 / 1.0003, 1e-7);
    close(number(&file(Firmware::Marlin), "; M92 X: multiply by "), 1.0 / 1.0003, 1e-7);
    close(number(&file(Firmware::Klipper), "[stepper_x]: multiply by "), 1.0003, 1e-7);
}

/// Squareness stated as a tilt of X rotates the part, but the square is right.
#[test]
fn a_tilt_of_x_is_skew_and_a_turn_of_the_part() {
    let machine = machine("EC0X = 1200.0\n");
    let found = settings(&machine);
    close(found.skew.xy, 0.0012, 1e-8);
    close(found.turn_rad, 0.0012, 1e-8);
    let Skew { xy, xz, yz } = found.skew;
    is_a_cube(|at| {
        let skewed = skewed(at, [xy, xz, yz]);
        tip(&machine, core::array::from_fn(|axis| skewed[axis] * found.steps[axis]))
    });
}

#[test]
fn grbl_holds_the_steps_alone() {
    let machine = machine(ERRORS);
    let facts = Facts::of(&machine, Vec::new(), String::new());
    let now = [(X, 250.0), (Y, 250.0), (Z, 400.0)];
    let written = write_settings(Firmware::Grbl, &settings(&machine), &machine, &facts, &now);
    let written = written.expect("written");
    let file = &written.files[0].text;
    close(number(file, "\n$100="), 250.0 / 1.0003, 1e-4);
    close(number(file, "\n$101="), 250.0 / (1.0 - 0.0002), 1e-3);
    close(number(file, "\n$102="), 400.0 / 1.0005, 1e-3);
    // A line is a setting or a comment.
    assert!(file.lines().all(|line| line.starts_with(['$', ';'])), "{file}");
    let notes = written.notes.join("\n");
    assert!(notes.contains("GRBL has no skew: XY -1200"), "{notes}");
}

#[test]
fn what_is_left() {
    let loss = |errors: &str, firmware| {
        let machine = machine(errors);
        let found = firmware_loss(&machine, &Temperatures::new(), &options(), firmware);
        found.expect("a loss").axes
    };
    for axis in loss(ERRORS, Firmware::Klipper) {
        // The maximum is 360 µm at Y = 300 mm. Beyond the travel, by up to 0.36 mm of correction, a curve of 0.3 µm/mm keeps its end value.
        assert!(axis.correction > 50.0 && axis.largest < 0.13, "{axis:?}");
    }
    let grbl = loss(ERRORS, Firmware::Grbl);
    close(grbl[0].largest, 300.0 * 1.2, 1.0);
    // A parabola from 0 to 0 with c·150² in the middle has no slope, so all of it remains.
    let bent = loss("EYX = { poly = [0.0, -0.3, 1.0e-3] }\n", Firmware::Marlin);
    close(bent[1].largest, 1.0e-3 * 150.0 * 150.0, 0.1);
}

#[test]
fn what_cannot_be() {
    let machine = machine(ERRORS);
    let facts = Facts::of(&machine, Vec::new(), String::new());
    let refused = |now: &[(_, f64)]| {
        write_settings(Firmware::Grbl, &settings(&machine), &machine, &facts, now)
            .expect_err("refused")
            .to_string()
    };
    assert_eq!(
        refused(&[(A, 80.0)]),
        "--steps: found axis A, expected X, Y or Z, which the machine has"
    );
    assert_eq!(refused(&[(X, 0.0)]), "--steps X: found 0, expected a number above 0");
    // An error of 1 mm on a travel of 2 mm is rejected.
    let short = Machine::parse(
        "structure = \"w b X t\"\n[axes]\nX.travel = [0.0, 2.0]\n[errors]\nEXX = { poly = [0.0, 500.0] }\n",
        "m.toml",
    );
    let fine = TableOptions { step_mm: 1.0, ..options() };
    let error = linear_settings(&short.expect("a machine"), &Temperatures::new(), &fine);
    let error = error.expect_err("refused").to_string();
    assert!(error.contains("between 0.9 and 1.1"), "{error}");
}
