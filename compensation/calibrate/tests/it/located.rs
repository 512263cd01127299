//! A five-axis machine whose error motions are all measured along lines, with stated location errors.

use std::fmt::Write as _;

use volcomp_calibrate::{Calibration, CalibrationFile, calibrate};
use volcomp_kinematics::{Form, State};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{AxisName, Displacement, ErrorName};

use crate::lab::{Lab, Line, Noise, measure};

pub(crate) const GEOMETRY: &str = "structure = \"w C' A' X' b Y Z t\"
[axes.X]
travel = [0.0, 600.0]
[axes.Y]
travel = [0.0, 500.0]
[axes.Z]
travel = [0.0, 400.0]
[axes.A]
travel = [-100.0, 30.0]
point = [20.0, 250.0, 120.0]
[axes.C]
travel = [0.0, 360.0]
modulo = 360
point = [320.0, 240.0, 0.0]
[tool]
tip = [0.0, 0.0, -50.0]
[workpiece]
origin = [300.0, 250.0, 150.0]
";

/// Location errors stated in the calibration file, µm or µrad.
pub(crate) const LOCATIONS: [(&str, f64); 7] = [
    ("EC0Y", 14.0),
    ("EA0Z", -11.0),
    ("EB0Z", 9.0),
    ("EY0A", 17.0),
    ("EB0A", 21.0),
    ("EC0A", -18.0),
    ("EA0C", -16.0),
];
/// Location errors of the two rotary axes that are not in `LOCATIONS`, µm or µrad.
pub(crate) const MORE: [(&str, f64); 4] =
    [("EZ0A", -12.0), ("EX0C", 15.0), ("EY0C", -13.0), ("EB0C", 12.0)];

/// Machine with error motions that are 0 at coordinate 0; its straightness errors have no best-fit line over equally spaced targets from end to end.
pub(crate) fn truth() -> Machine {
    let mut errors = String::new();
    for (place, (axis, low, high)) in
        [("X", 0.0, 600.0), ("Y", 0.0, 500.0), ("Z", 0.0, 400.0)].into_iter().enumerate()
    {
        for (k, component) in ["EX", "EY", "EZ", "EA", "EB", "EC"].into_iter().enumerate() {
            let wave = |f: f64| (f * (7 * place + 5 * k + 2) as f64).sin();
            let coefficients = if k < 3 && k != place {
                // t² minus its mean over 11 equally spaced targets, t from −1 to 1 over the travel.
                let (middle, half) = (0.5_f64 * (low + high), 0.5_f64 * (high - low));
                let size = 8.0 * wave(1.1);
                [
                    size * ((middle / half).powi(2) - 0.4),
                    -2.0 * size * middle / half.powi(2),
                    size / half.powi(2),
                ]
            } else {
                [0.0, 20.0 * wave(0.7) / high, 15.0 * wave(1.9) / (high * high)]
            };
            writeln!(errors, "{component}{axis} = {{ poly = {coefficients:?} }}")
                .expect("a String");
        }
    }
    for (k, component) in ["EX", "EY", "EZ", "EA", "EB", "EC"].into_iter().enumerate() {
        let size = 6.0 + k as f64;
        // The parallelism of A must not be identified as this slope.
        let slope = if component == "EB" { 0.049 } else { -0.03 - 0.01 * k as f64 };
        writeln!(errors, "{component}A = {{ poly = [0.0, {slope:?}, 0.0004] }}").expect("a String");
        writeln!(
            errors,
            "{component}C = {{ fourier = [{0:?}, {1:?}, {size:?}, {1:?}, 2.0], period = 360.0 }}",
            size,
            -0.5 * size
        )
        .expect("a String");
    }
    for (name, value) in LOCATIONS.iter().chain(&MORE) {
        writeln!(errors, "{name} = {value:?}").expect("a String");
    }
    Machine::parse(&format!("{GEOMETRY}[errors]\n{errors}"), "truth").expect("a machine")
}

/// Tables of all 30 lines for a calibration file, with noise of 0.3 µm or µrad; `rotary` selects the errors of rotary axes.
pub(crate) fn lines(lab: &Lab, truth: &Machine, rotary: impl Fn(&str) -> bool) -> String {
    use AxisName::{X, Y, Z};
    let mut noise = Noise::new(5);
    let mut text = String::new();
    for (axis, at, point, other, curve) in [
        ("X", &[(Y, 200.0), (Z, 150.0)][..], [30.0, 180.0, 90.0], true, "poly = { order = 2 }"),
        ("Y", &[(X, 300.0), (Z, 100.0)], [0.0, 20.0, 60.0], false, "poly = { order = 2 }"),
        ("Z", &[(X, 250.0), (Y, 240.0)], [40.0, 260.0, 10.0], false, "poly = { order = 2 }"),
        // The table of X has moved by 300 mm to −X, and the rotary axes on it are at X = −280 and 20.
        ("A", &[(X, 300.0)], [-240.0, 290.0, 180.0], false, "poly = { order = 2 }"),
        ("C", &[(X, 300.0)], [70.0, 200.0, 160.0], false, "fourier = { order = 2 }"),
    ] {
        for component in ["EX", "EY", "EZ", "EA", "EB", "EC"] {
            let error = format!("{component}{axis}");
            if matches!(axis, "A" | "C") && !rotary(&error) {
                continue;
            }
            let line = Line { error: &error, at, point, other, targets: 11, runs: 3 };
            let file = format!("{error}.csv");
            text += &measure(lab, truth, &file, &line, 0.3, &mut noise);
            writeln!(text, "curve = {{ {curve} }}").expect("a String");
        }
    }
    text
}

/// Largest difference of the position errors of two machines over the volume, µm.
pub(crate) fn largest_difference_um(one: &Machine, other: &Machine) -> f64 {
    let none = Temperatures::new();
    let mut largest = 0.0_f64;
    for place in 0..3 * 3 * 3 * 5 * 8 {
        let mut rest = place;
        let mut state = State::default();
        for (index, axis) in one.axes().iter().enumerate() {
            let count = match axis.name {
                AxisName::C => 8,
                AxisName::A => 5,
                _ => 3,
            };
            let [low, high] = axis.travel;
            let at = low + (high - low) * f64::from(rest % count) / f64::from(count - 1);
            state.q[index] = Displacement::from_coordinate(axis.name.kind(), at).mm_or_rad();
            rest /= count;
        }
        let [a, b] =
            [one, other].map(|machine| machine.error_at(&state, Form::Exact, &none).position_mm);
        largest = largest.max((a - b).norm() * 1e3);
    }
    largest
}

/// Mean slope of an error motion between two coordinates, per deg.
pub(crate) fn slope(machine: &Machine, error: &str, from: f64, to: f64) -> f64 {
    let name: ErrorName = error.parse().expect("a name");
    let index = machine.index_of(name.axis).expect("an axis");
    let value = |at: f64| {
        let mut coordinates = [0.0; 9];
        coordinates[index] = at;
        machine.error(name).expect("a curve").value(index, &coordinates, None)
    };
    (value(to) - value(from)) / (to - from)
}

#[test]
fn every_motion_and_the_locations_make_the_machine() {
    let lab = Lab::new(GEOMETRY);
    let truth = truth();
    let mut text = lines(&lab, &truth, |_| true);
    let mut noise = Noise::new(9);
    // Some location errors have a table each; several are in one table of one instrument, with its sign.
    for (name, value) in LOCATIONS {
        let unit = if name.starts_with("EY") { "um" } else { "urad" };
        let value = value + noise.normal(0.3);
        writeln!(text, "[[location]]\nerror = \"{name}\"\nvalue_{unit} = {value}")
            .expect("a String");
    }
    text += "[[location]]\nerrors = [\"EZ0A\", \"EX0C\", \"EY0C\"]\nvalues_um = [12.0, -15.0, 13.0]\nsign = -1\nuncertainty_um = 0.3\n";
    text += "[[location]]\nerror = \"EB0C\"\nvalue_urad = 12.0\nuncertainty_urad = 0.3\n";
    let found = lab.calibrated(&text);
    let left = largest_difference_um(&found.machine, &truth);
    assert!(left <= 2.0, "{left} µm are left");
    // A tilt of 18 µrad would give −0.31 µrad/deg.
    let [found_slope, expected] =
        [&found.machine, &truth].map(|machine| slope(machine, "EBA", -30.0, 30.0));
    assert!((found_slope - expected).abs() < 0.01, "{found_slope} for {expected}");
    assert!(found.warnings.is_empty(), "{:?}", found.warnings);
}

/// Largest |(R⁻¹ω − ω) × p| of a tilt of C by 10 µrad about X or Y, over eighths of a turn and the corners, µm.
fn tilt_of_c_um(about_y: bool) -> f64 {
    let mut largest = 0.0_f64;
    for eighth in 0..8 {
        let (s, c) = (f64::from(eighth) * core::f64::consts::FRAC_PI_4).sin_cos();
        let [a, b] = if about_y { [s, c - 1.0] } else { [c - 1.0, -s] };
        for corner in 0..8 {
            let at = |bit: i32, length: f64| if corner & bit == 0 { 0.0 } else { length };
            let [x, y, z] = [at(1, 300.0), at(2, 200.0), at(4, 400.0)];
            let moved = [b * z, -a * z, a * y - b * x];
            largest = largest.max(moved.iter().map(|m| m * m).sum::<f64>().sqrt());
        }
    }
    largest * 10e-3
}

#[test]
fn unmeasured_errors_are_listed_with_their_effect() {
    let geometry = "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [0, 300]\nY.travel = [0, 200]\nZ.travel = [0, 400]\nC.travel = [0, 360]\n";
    let text = "[[location]]\nerror = \"EX0C\"\nvalue_um = 3.0\n[[location]]\nerror = \"EA0Z\"\nvalue_urad = 2.0\n";
    let warnings = Lab::new(geometry).calibrated(text).warnings;
    for (name, effect_um) in [
        ("EY0C", 20.0),
        ("EA0C", tilt_of_c_um(false)),
        ("EB0C", tilt_of_c_um(true)),
        ("EC0Y", 10e-3 * 200.0),
        ("EB0Z", 10e-3 * 400.0),
    ] {
        let found = warnings.iter().find(|note| note.starts_with(name)).expect(name);
        let expected = format!("by up to {effect_um:.1} µm");
        assert!(found.contains("taken as 0") && found.contains(&expected), "{found}: {expected}");
    }
    assert!(
        !warnings.iter().any(|note| note.starts_with("EX0C") || note.starts_with("EA0Z")),
        "{warnings:?}"
    );
}

/// A `[[location]]` with one tilt of a pair states the whole squareness, as `[[squareness]]` does. The value of the
/// other tilt in the machine file has no effect.
#[test]
fn a_location_states_the_whole_squareness() {
    let geometry = "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 300]\nY.travel = [0, 200]\nZ.travel = [0, 400]\n";
    let lab = Lab::new(&format!("{geometry}[errors]\nEC0X = 5.0\n"));
    // The angle between X and Y is the tilt of Y minus that of X.
    let square = |found: &Calibration| {
        let tilt = |name: &str| {
            let name: ErrorName = name.parse().expect("a name");
            found.machine.locations().get(&name).copied()
        };
        tilt("EC0Y").unwrap_or_default() - tilt("EC0X").unwrap_or_default()
    };
    for table in ["location", "squareness"] {
        let found = lab.calibrated(&format!("[[{table}]]\nerror = \"EC0Y\"\nvalue_urad = 12\n"));
        let value = square(&found);
        assert!((value - 12.0).abs() < 1e-12, "{table}: {value}");
        let is_noted = found.warnings.iter().any(|note| note.contains("EC0"));
        assert!(!is_noted, "{:?}", found.warnings);
    }
    let found = lab.calibrated("");
    assert!((square(&found) + 5.0).abs() < 1e-12);
    let kept = "EC0X was not measured and is kept from the machine file: 5 µrad of it";
    let is_noted = found.warnings.iter().any(|note| note.starts_with(kept));
    assert!(is_noted, "{:?}", found.warnings);
}

/// An unknown tilt of a rotary axis and the only tilt line, which changes by almost the same amount as the unknown, are
/// solved together and determined; alternating between them does not converge.
#[test]
fn unknowns_that_lines_contain_are_found_with_them() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/tilt");
    let file = CalibrationFile::read(&folder.join("c.toml")).expect("read");
    let found = calibrate(&file, |_, _| {}).expect("found");
    let identified = found.identified.expect("unknowns");
    let own = |p: &&volcomp_identify::Parameter| p.name == "EB0A";
    let tilt = identified.found.parameters.iter().find(own);
    let tilt = tilt.expect("an unknown");
    let uncertainty = tilt.uncertainty.expect("determined");
    assert!((tilt.value + 37.8).abs() < 2.0 * uncertainty && uncertainty < 1.0, "{tilt:?}");
    let is_noted = |note: &String| note.contains("they were found together");
    assert!(found.warnings.iter().any(is_noted), "{:?}", found.warnings);
}

type M = [[f64; 4]; 4];

/// The constant of ECC that the machine file keeps, rad.
const TURN: f64 = 100e-6;
/// The squareness error EC0Y, rad.
const SQUARE: f64 = 22e-6;
/// A point on the table, mm in table axes.
const ON_TABLE: [f64; 4] = [250.0, 120.0, 40.0, 1.0];
/// A point on the tool, mm in tool axes.
const ON_TOOL: [f64; 4] = [30.0, -20.0, 60.0, 1.0];

fn product(a: &M, b: &M) -> M {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn image(m: &M, p: [f64; 4]) -> [f64; 4] {
    std::array::from_fn(|i| (0..4).map(|k| m[i][k] * p[k]).sum())
}

fn shift(x: f64, y: f64) -> M {
    [[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
}

fn about_z(angle: f64) -> M {
    let (s, c) = angle.sin_cos();
    [[c, -s, 0.0, 0.0], [s, c, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
}

/// Pose of the tool in workpiece axes of `w X' b Y Z C B t`. Y is out of square by `SQUARE` towards −X. C is at 0 and
/// has its constant rotation.
fn tool(x: f64, y: f64) -> M {
    let slide = shift(-SQUARE.sin() * y, SQUARE.cos() * y);
    product(&product(&shift(x, 0.0), &slide), &about_z(TURN))
}

/// Pose of the workpiece in tool axes: the inverse of [`tool`].
fn table(x: f64, y: f64) -> M {
    let slide = shift(SQUARE.sin() * y, -SQUARE.cos() * y);
    product(&product(&about_z(-TURN), &slide), &shift(-x, 0.0))
}

/// EYX, µm: a point of the table passes a straightedge in the spindle, which is aligned to the workpiece's X. Positive if the point is displaced
/// towards −Y.
fn eyx(x: f64) -> f64 {
    let aligned = about_z(TURN);
    let across = |x: f64| image(&aligned, image(&table(x, 0.0), ON_TABLE))[1];
    (across(0.0) - across(x)) * 1e3
}

/// EXY, µm: a point of the tool moves along a straightedge on the table.
fn exy(y: f64) -> f64 {
    (image(&tool(0.0, y), ON_TOOL)[0] - image(&tool(0.0, 0.0), ON_TOOL)[0]) * 1e3
}

#[test]
fn a_kept_turn_of_the_tool_is_not_squareness() {
    let file = |lab: &Lab, name: &str, reading: fn(f64) -> f64| {
        let mut csv = String::from("target,deviation\n");
        for step in 0..=5 {
            let target = 100.0 * f64::from(step);
            writeln!(csv, "{target},{:.9}", reading(target)).expect("a String");
        }
        lab.write(name, &csv);
    };
    let geometry = "structure = \"w X' b Y Z C B t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 500]\nZ.travel = [0, 500]\nC.travel = [-90, 90]\nB.travel = [-90, 90]\n";
    let lines = "[[measurement]]\nerror = \"EYX\"\nfile = \"eyx.csv\"\nunit = \"um\"\n[[measurement]]\nerror = \"EXY\"\nfile = \"exy.csv\"\nunit = \"um\"\n[[squareness]]\nerror = \"EC0Y\"\nreference_angle_urad = 0.0\n";
    for kept in ["", "[errors]\nECC = 100.0\n"] {
        let lab = Lab::new(&format!("{geometry}{kept}"));
        file(&lab, "eyx.csv", eyx);
        file(&lab, "exy.csv", exy);
        let found = lab.calibrated(lines);
        let (_, value) = found.squareness[0];
        assert!((value.0 - SQUARE * 1e6).abs() < 0.01, "{kept}: {value}");
    }
}
