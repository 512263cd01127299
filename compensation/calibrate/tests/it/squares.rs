//! Squareness from a square, beams and diagonals, and the reference lines of straightness.

use std::{fmt::Write as _, fs};

use volcomp_calibrate::Calibration;
use volcomp_kinematics::{Form, nalgebra::Vector3};
use volcomp_model::{Machine, Temperatures};
use volcomp_test_support::cases;
use volcomp_vocabulary::{AxisName, Direction};

use crate::lab::Lab;

/// Edges of the working space, mm.
const EDGES: [f64; 3] = [600.0, 400.0, 300.0];
const GEOMETRY: &str = "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 600]\nY.travel = [0, 400]\nZ.travel = [0, 300]\n[tool]\ntip = [20, 10, -80]\n";
/// Known errors of the machine, without its squareness.
const KNOWN: &str = "EXX = { poly = [0, 0.03] }\nEYY = { mean = { poly = [0, -0.01] }, reversal = 2.0 }\nEZZ = { poly = [0, 0.02, 1e-5] }\nEAY = { poly = [0, 0.05] }\nECX = { poly = [0, -0.04] }\nEYX = { poly = [0, 0.01, -2e-5] }\n";

fn position_um(machine: &Machine, at: [f64; 3], approach: Option<[Direction; 3]>) -> Vector3<f64> {
    let names = [AxisName::X, AxisName::Y, AxisName::Z];
    let mut state =
        machine.state(&std::array::from_fn::<_, 3, _>(|i| (names[i], at[i]))).expect("a state");
    for (axis, name) in names.into_iter().enumerate() {
        let index = machine.index_of(name).expect("an axis");
        state.approach[index] = approach.map(|approach| approach[axis]);
    }
    let none = Temperatures::new();
    machine.error_at(&state, Form::Exact, &none).position_mm * 1e3
}

/// Writes the file of a laser along a diagonal with unknown scale and zero. Returns its table for the calibration file,
/// and the difference of the deviations at its two ends, µm.
fn diagonal(lab: &Lab, truth: &Machine, name: &str, ends: [[f64; 3]; 2]) -> (String, f64) {
    let [from, to] = ends.map(Vector3::from);
    let way = to - from;
    let (length, along) = (way.norm(), way.normalize());
    let approach =
        std::array::from_fn(
            |i| {
                if way[i] > 0.0 { Direction::Positive } else { Direction::Negative }
            },
        );
    let mut csv = String::from("target,run,direction,deviation\n");
    let mut ends_um = [0.0; 2];
    for step in 0..=10 {
        let share = f64::from(step) / 10.0;
        let at = from + way * share;
        let deviation = position_um(truth, at.into(), Some(approach)).dot(&along);
        ends_um[usize::from(step > 0)] = deviation;
        let read = deviation + 7.0 + 0.004 * length * share;
        writeln!(csv, "{},1,+,{read:.9}", length * share).expect("a String");
    }
    lab.write(name, &csv);
    let place = |p: Vector3<f64>| format!("{{ X = {:?}, Y = {:?}, Z = {:?} }}", p.x, p.y, p.z);
    let table = format!("{{ file = \"{name}\", from = {}, to = {} }}", place(from), place(to));
    (table, ends_um[1] - ends_um[0])
}

/// Ends of a body diagonal: for P from the lower to the upper end of the travel, for N the opposite.
fn body(name: &str) -> [[f64; 3]; 2] {
    let place = |begin: bool| {
        std::array::from_fn(|i| {
            let positive = name.as_bytes()[i] == b'P';
            if positive == begin { 0.0 } else { EDGES[i] }
        })
    };
    [place(true), place(false)]
}

fn value(found: &Calibration, name: &str) -> f64 {
    let of = |(error, _): &&(volcomp_vocabulary::ErrorName, _)| error.to_string() == name;
    found.squareness.iter().find(of).expect("a squareness").1.0
}

#[test]
fn body_diagonals_match_the_closed_form() {
    let squares = [("EC0Y", 25.0), ("EA0Z", -14.0), ("EB0Z", 18.0)];
    for known in ["", KNOWN] {
        let machine = format!("{GEOMETRY}[errors]\n{known}");
        let lab = Lab::new(&machine);
        let errors = squares.map(|(name, value)| format!("{name} = {value}\n")).concat();
        let truth = Machine::parse(&format!("{machine}{errors}"), "truth");
        let truth = truth.expect("a machine");
        let names = ["PPP", "NPP", "PNP", "PPN"];
        let measured: Vec<(String, f64)> = names
            .iter()
            .map(|name| diagonal(&lab, &truth, &format!("{name}.csv"), body(name)))
            .collect();
        let tables: Vec<&str> = measured.iter().map(|(table, _)| table.as_str()).collect();
        let text = format!(
            "[[squareness]]\nerrors = [\"EC0Y\", \"EA0Z\", \"EB0Z\"]\ndiagonals = [{}]\nuncertainty_um = 0.5\n",
            tables.join(", ")
        );
        let found = lab.calibrated(&text);
        for (name, expected) in squares {
            let value = value(&found, name);
            assert!((value - expected).abs() < 0.01, "{name}: {value}");
        }
        assert!(!found.warnings.iter().any(|w| w.contains("EC0Y")), "{:?}", found.warnings);
        if known.is_empty() {
            // The contrasts of the book, computed from the lengths alone.
            let [a, b, c] = EDGES;
            let d = (a * a + b * b + c * c).sqrt();
            let [ppp, npp, pnp, ppn] = [0, 1, 2, 3].map(|k: usize| measured[k].1 * 1e3);
            for (name, by_hand) in [
                ("EC0Y", d / (4.0 * a * b) * (-ppp + npp + pnp - ppn)),
                ("EB0Z", d / (4.0 * a * c) * (ppp - npp + pnp - ppn)),
                ("EA0Z", d / (4.0 * b * c) * (-ppp - npp + pnp + ppn)),
            ] {
                let value = value(&found, name);
                assert!((value - by_hand).abs() < 0.01, "{name}: {value} {by_hand}");
            }
        }
    }
}

#[test]
fn face_diagonals_give_the_squareness_of_their_plane() {
    let lab = Lab::new(&format!("{GEOMETRY}[errors]\n{KNOWN}EC0X = 80.0\n"));
    let truth = format!("{GEOMETRY}[errors]\n{KNOWN}EC0X = -32.0\nEA0Z = 5.0\n");
    let truth = Machine::parse(&truth, "truth").expect("a machine");
    let [a, b, _] = EDGES;
    let (pp, _) = diagonal(&lab, &truth, "pp.csv", [[0.0; 3], [a, b, 0.0]]);
    let (np, _) = diagonal(&lab, &truth, "np.csv", [[a, 0.0, 0.0], [0.0, b, 0.0]]);
    let table = format!("[[squareness]]\nerror = \"EC0Y\"\ndiagonals = [{pp}, {np}]\n");
    // With Y as primary reference axis the squareness is the tilt of X; its value in the machine file is not used.
    let text = format!(
        "reference_axes = [\"Y\", \"X\"]\n{table}[[location]]\nerror = \"EA0Z\"\nvalue_urad = 5.0\n"
    );
    let found = lab.calibrated(&text);
    assert!((value(&found, "EC0Y") - 32.0).abs() < 0.01, "{:?}", found.squareness);
    let tilt = found.machine.locations()[&"EC0X".parse().expect("a name")];
    assert!((tilt + 32.0).abs() < 0.01, "{tilt}");
    // A diagonal in one plane has no information about another plane.
    let message = lab.refused(&table.replace("EC0Y", "EB0Z"));
    assert!(message.contains("EB0Z from ") && message.contains("do not determine"), "{message}");
}

/// If diagonals scatter far more than stated, a note names the files and states that the squareness is unreliable.
#[test]
fn diagonals_that_scatter_are_noted() {
    let lab = Lab::new(GEOMETRY);
    let truth = Machine::parse(GEOMETRY, "truth").expect("a machine");
    let [a, b, _] = EDGES;
    let (pp, _) = diagonal(&lab, &truth, "pp.csv", [[0.0; 3], [a, b, 0.0]]);
    let ends = [[a, 0.0, 0.0], [0.0, b, 0.0]];
    let (np, _) = diagonal(&lab, &truth, "np.csv", ends);
    let table = format!(
        "[[squareness]]\nerror = \"EC0Y\"\ndiagonals = [{pp}, {np}]\nuncertainty_um = 0.1\n"
    );
    let notes = || {
        let found = lab.calibrated(&table);
        let own = found.warnings.into_iter();
        own.filter(|note| note.starts_with("EC0Y from diagonals: ")).collect::<Vec<_>>()
    };
    let quiet = notes();
    assert!(!quiet.iter().any(|note| note.contains("uncertaint")), "{quiet:?}");
    for name in ["pp.csv", "np.csv"] {
        let text = fs::read_to_string(lab.folder().join(name)).expect("read");
        let scattered: Vec<String> = text
            .lines()
            .enumerate()
            .map(|(line, text)| match text.rsplit_once(',') {
                Some((before, deviation)) if line > 0 => {
                    let deviation: f64 = deviation.parse().expect("a number");
                    let off = 300.0 * (2.7 * line as f64).sin();
                    format!("{before},{}", deviation + off)
                }
                _ => text.to_owned(),
            })
            .collect();
        lab.write(name, &scattered.join("\n"));
    }
    let found = notes();
    assert!(found.iter().any(|note| note.contains("uncertaint")), "{found:?}");
    assert!(!found.iter().any(|note| note.contains(":0:")), "{found:?}");
}

fn straight(lab: &Lab, name: &str, length: f64, profile: impl Fn(f64) -> f64) {
    let mut csv = String::from("target,deviation\n");
    for step in 0..=12 {
        let q = length * f64::from(step) / 12.0;
        writeln!(csv, "{q},{:.9}", profile(q)).expect("a String");
    }
    lab.write(name, &csv);
}

const LINES: &str = "[[measurement]]\nerror = \"EYX\"\nfile = \"eyx.csv\"\ncurve = { table = {} }\nLINE\n[[measurement]]\nerror = \"EXY\"\nfile = \"exy.csv\"\ncurve = { table = {} }\nLINE\n[[squareness]]\nerror = \"EC0Y\"\n";

/// Each kind of reference line gives the same machine after alignment of the workpiece, because a line removed from the
/// straightness is added to the squareness.
#[test]
fn reference_lines_split_the_same_machine_differently() {
    let lab = Lab::new(GEOMETRY);
    straight(&lab, "eyx.csv", 600.0, |q| 4.0 + 0.02 * q + 6.0 * (q / 100.0).sin());
    straight(&lab, "exy.csv", 400.0, |q| -0.01 * q + 3.0 * (q / 60.0).cos());
    let mut machines = Vec::new();
    let mut squares = Vec::new();
    for kind in ["least-squares", "end-points", "minimum-zone"] {
        let text = LINES.replace("LINE", &format!("reference_line = \"{kind}\""));
        let found = lab.calibrated(&text);
        squares.push(value(&found, "EC0Y"));
        machines.push(found.machine);
    }
    assert!((squares[0] - squares[1]).abs() > 1.0, "{squares:?}");
    assert!((squares[0] - squares[2]).abs() > 0.1, "{squares:?}");
    for machine in &machines[1..] {
        let difference = |at| position_um(machine, at, None) - position_um(&machines[0], at, None);
        let constant = difference([0.0; 3]);
        let turn = (difference([600.0, 0.0, 0.0]) - constant).y / 600.0;
        for x in [0.0, 250.0, 600.0] {
            for y in [0.0, 150.0, 400.0] {
                let rigid = constant + Vector3::new(-turn * y, turn * x, 0.0);
                let left = difference([x, y, 100.0]) - rigid;
                assert!(left.norm() < 1e-3, "{left} at {x} {y}");
            }
        }
    }
    let ends = position_um(&machines[1], [600.0, 0.0, 0.0], None)
        - position_um(&machines[1], [0.0; 3], None);
    assert!(ends.norm() < 1e-6, "both ends of X lie on its line: {ends}");
}

/// EC0Y = (φ − 90°) − slope(EXY) − slope(EYX) with slopes of 4 and 10 µrad; for a beam against its axis φ becomes 180° − φ.
#[test]
fn squares_and_beams_count_in_the_direction_of_the_light() {
    let lab = Lab::new(GEOMETRY);
    straight(&lab, "eyx.csv", 600.0, |q| 0.010 * q);
    straight(&lab, "exy.csv", 400.0, |q| 0.004 * q);
    let angle = 90.0 + 5e-6_f64.to_degrees();
    for (keys, expected) in [
        ("reference_angle_urad = 5.0".to_owned(), -9.0),
        ("optical_square_urad = 5.0".to_owned(), -9.0),
        ("optical_square_urad = 5.0\nbeams = [\"+X\", \"-Y\"]".to_owned(), -19.0),
        ("optical_square_urad = 5.0\nbeams = [\"-Y\", \"-X\"]".to_owned(), -9.0),
        (format!("beam_angle_deg = {angle}"), -9.0),
        (format!("beam_angle_deg = {angle}\nbeams = [\"-X\", \"+Y\"]"), -19.0),
    ] {
        let found = lab.calibrated(&format!("{}{keys}\n", LINES.replace("LINE", "")));
        let value = value(&found, "EC0Y");
        assert!((value - expected).abs() < 1e-6, "{keys}: {value}");
    }
    for [keys, expected] in &cases(
        r#"
beams = ["+X", "+Y"] | beams: expected only with `optical_square_urad` or `beam_angle_deg`
optical_square_urad = 1\nbeams = ["X", "Y"] | ["+X", "-Y"]
optical_square_urad = 1\nbeams = ["+X", "+X"] | ["+X", "-Y"]
beam_angle_deg = 0.0001 | expected an angle between 89 and 91 deg
beam_angle_deg = 90\nvalue_urad = 3 | found value_urad and beam_angle_deg together
uncertainty_um = 1 | expected only with `diagonals`
diagonals = [{ file = "eyx.csv", from = {}, to = { X = 600 } }] | found 1 diagonals
diagonals = [{ file = "eyx.csv", from = {}, to = { X = 60 } }, { file = "eyx.csv", from = {}, to = { X = 60 } }] | found targets from 0 to 600 mm, expected distances from the beginning of the diagonal, 0 to 60.0 mm
diagonals = [{ file = "eyx.csv", from = {}, to = {} }, { file = "eyx.csv", from = {}, to = { X = 60 } }] | the same place
"#,
    ) {
        let message = lab.refused(&format!("{}{keys}\n", LINES.replace("LINE", "")));
        assert!(message.contains(expected), "{keys}: {message}");
    }
}

/// Computed by hand. EXY: the slopes of three runs are −6, 1 and 5 µrad, s²/n = 62/2/3 with ν = 2. EYX: one run has
/// residuals of −0.6, 1.8, −1.8 and 0.6 µm at a spacing of 200 mm, s² = 3.6, Σ(q − q̄)² = 5 · 200², hence 18 µrad² with
/// ν = 2. Together √28.33 µrad with ν = 3.727, for which Student's t is 2.957 at 95.45 %.
#[test]
fn the_uncertainty_of_a_squareness_contains_both_slopes() {
    let lab = Lab::new(GEOMETRY);
    lab.write("eyx.csv", "target,deviation\n0,0\n200,3\n400,0\n600,3\n");
    let mut csv = String::from("target,run,direction,deviation\n");
    for (run, slope) in [(1, -6.0), (2, 1.0), (3, 5.0)] {
        for target in [0.0, 200.0, 400.0] {
            // The zero of a run and the profile do not affect the scatter of the slopes.
            let profile = if target == 200.0 { 8.0 } else { 0.0 };
            let value = 100.0 * f64::from(run) + profile + 1e-3 * slope * target;
            writeln!(csv, "{target},{run},+,{value:.9}").expect("a String");
        }
    }
    lab.write("exy.csv", &csv);
    let found = |more: &str| {
        let text = format!("{more}{}reference_angle_urad = 0\n", LINES.replace("LINE", ""));
        let found = lab.calibrated(&text).square_uncertainties;
        found[&"EC0Y".parse().expect("a name")]
    };
    let near =
        |found: f64, expected: f64| assert!((found - expected).abs() < 2e-3, "{found} {expected}");
    near(found("").0, 7.8712);
    near(found("[uncertainty]\nsquare_urad = 3.0\n").0, 7.8712_f64.hypot(3.0));
    // 0.5 µm of each mean reading changes the slopes by 0.5 µm/√(5 · 200²) per mm and 0.5 µm/√(2 · 200²) per mm.
    let of_readings = (500.0 / 2e5_f64.sqrt()).hypot(500.0 / 8e4_f64.sqrt());
    near(found("[uncertainty]\nreading_um = 0.5\n").0, 7.8712_f64.hypot(of_readings));
    let file = lab
        .read(&format!("{}reference_angle_urad = 0\n", LINES.replace("LINE", "")))
        .expect("a file");
    let of_one_run = volcomp_calibrate::squareness_lines_of_one_run(&file);
    let names: Vec<String> = of_one_run.map(|line| line.setup.error.to_string()).collect();
    assert_eq!(names, ["EYX"]);
}

/// A bridge is moved over three steps in two runs, whose tilts differ by 4 µrad: the slopes are ±2 µrad, s/√n = 2 µrad
/// with ν = 1. With one run, the scatter is that of its three tilts of 5, 8 and 11 µrad, s = 3 µrad; the weights of the
/// three tilts in the slope are 0.3, 0.4, 0.3.
#[test]
fn the_uncertainty_of_a_squareness_contains_the_slopes_of_bridges() {
    let lab = Lab::new(GEOMETRY);
    let bridge = "method = \"angular\"\nbridge_mm = 200\nreading = \"slope\"\nunit = \"urad\"";
    let text = format!("{}reference_angle_urad = 0\n", LINES.replace("LINE", "")).replacen(
        "curve = { table = {} }",
        &format!("curve = {{ table = {{}} }}\n{bridge}"),
        1,
    );
    straight(&lab, "exy.csv", 400.0, |q| 0.004 * q);
    let found = |csv: &str| {
        lab.write("eyx.csv", &format!("target,run,direction,deviation\n{csv}"));
        let found = lab.calibrated(&text).square_uncertainties;
        2.0 * found[&"EC0Y".parse().expect("a name")].0
    };
    let two = found(
        "0,1,+,0\n200,1,+,5\n400,1,+,8\n600,1,+,11\n0,2,+,0\n200,2,+,9\n400,2,+,12\n600,2,+,15\n",
    );
    assert!((two - 13.9677 * 2.0).abs() < 1e-3, "{two}");
    let one = found("0,1,+,0\n200,1,+,5\n400,1,+,8\n600,1,+,11\n");
    assert!((one - 4.5265 * 3.0 * 0.34_f64.sqrt()).abs() < 1e-3, "{one}");
}
