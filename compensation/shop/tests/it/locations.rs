//! Location errors that are measured directly, and their entries in the calibration file.
//!
//! Their values are positions of axes with all axes at `reference`, relative to the tip and along the reference
//! directions.

use std::fmt::Write as _;
use std::path::Path;

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_model::Machine;
use volcomp_shop::{Shop, ShopError};
use volcomp_test_support::rows;
use volcomp_vocabulary::ErrorName;

use crate::both_sides::{every_error, every_line, round_trip};
use crate::figures::compare;
use crate::write;

const TRUTH: &str = "structure = \"w C' B' X' b Y Z t\"
[axes]
C.travel = [0, 360]
B.travel = [-90, 90]
X.travel = [0, 500]
Y.travel = [0, 400]
Z.travel = [0, 300]
[errors]
EX0C = 31.0
EY0C = -17.0
EA0C = 42.0
EX0B = 5.0
";

fn shop(text: &str) -> Result<Shop, ShopError> {
    let text = format!("machine = \"truth.toml\"\n{text}");
    Shop::parse(&text, "shop.toml", |_| Ok(Machine::parse(TRUTH, "truth.toml")?))
}

fn calibrated(text: &str, folder: &Path) -> Machine {
    write(&shop(text).expect("valid"), folder);
    let file = CalibrationFile::read(&folder.join("calibration.toml")).expect("read back");
    calibrate(&file, |_, _| {}).expect("calibrated").machine
}

fn value(machine: &Machine, name: &str) -> Option<f64> {
    let name: ErrorName = name.parse().expect("a name");
    machine.locations().get(&name).copied()
}

#[test]
fn values_without_noise_are_those_of_the_truth() {
    let folder = tempfile::tempdir().expect("a folder");
    let text = "[[location]]\nerrors = [\"EX0C\", \"EY0C\"]\n[[location]]\nerror = \"EA0C\"\n";
    let found = calibrated(text, folder.path());
    assert_eq!(value(&found, "EX0C"), Some(31.0));
    assert_eq!(value(&found, "EY0C"), Some(-17.0));
    assert_eq!(value(&found, "EA0C"), Some(42.0));
    assert_eq!(value(&found, "EX0B"), None, "was not measured");
}

/// The noise over many seeds has the standard deviation that the calibration file states.
#[test]
fn the_noise_is_what_the_file_states() {
    let mut squares = 0.0;
    let seeds = 400;
    for seed in 0..seeds {
        let text = format!("seed = {seed}\n[[location]]\nerror = \"EX0C\"\nnoise_um = 2.5\n");
        let files = shop(&text).expect("valid").files(|_, _| {}).expect("made");
        let (_, text) = files.iter().find(|(name, _)| name == "calibration.toml").expect("made");
        let number = |key: &str| {
            let line = text.lines().find(|line| line.starts_with(key));
            let line = line.expect("the key is there");
            line.rsplit(" = ").next().expect("a value").parse::<f64>().expect("a number")
        };
        assert_eq!(number("uncertainty_um"), 2.5);
        squares += (number("value_um") - 31.0).powi(2);
    }
    let deviation = (squares / f64::from(seeds)).sqrt();
    // The standard deviation of 400 values is known within 3.5 %.
    assert!((deviation / 2.5 - 1.0).abs() < 0.12, "{deviation}");
}

/// A line of a rotary axis contains the effect of its location errors. If these are measured directly, the calibration
/// subtracts their effect: less than 0.5 µm remain.
#[test]
fn lines_of_the_axis_are_freed_of_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let lines = "[instrument]\nalignment_urad = 0\nboth_directions = false\nruns = 1\n[[measurement]]\nerror = \"EXC\"\nat = { X = 0, Y = 0, Z = 0, B = 0 }\n";
    let all = "[[location]]\nerrors = [\"EX0C\", \"EY0C\"]\n[[location]]\nerror = \"EA0C\"\n[[location]]\nerror = \"EX0B\"\n";
    let largest = |machine: &Machine| {
        let exc = machine.error("EXC".parse().expect("a name")).expect("measured");
        let own = machine.index_of(volcomp_vocabulary::AxisName::C).expect("there");
        let places = (0..=36).map(|step| {
            let mut at = [0.0; 9];
            at[own] = 10.0 * f64::from(step);
            exc.value(own, &at, None)
        });
        let values: Vec<f64> = places.collect();
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        values.iter().fold(0.0_f64, |most, x| most.max((x - mean).abs()))
    };
    let without = largest(&calibrated(lines, folder.path()));
    let with = largest(&calibrated(&format!("{lines}{all}"), folder.path()));
    assert!(without > 20.0, "{without}");
    assert!(with < 0.5, "{with}");
}

#[test]
fn what_is_wrong_is_named() {
    for [text, expected] in rows(
        r#"
error = "EXX"\n | expected a location error E?0N
error = "EC0Y"\n | found EC0Y, a squareness
errors = ["EX0C", "EA0C"]\n | give each kind its own table
error = "EX0C"\nnoise_urad = 1.0\n | EX0C is in um, expected `noise_um`
error = "EX0C"\nnoise_um = -1.0\n | noise_um
error = "EX0A"\n | no axis A
error = "EX0C"\n[[location]]\nerror = "EX0C"\n | EX0C appears in two [[location]] tables
errors = []\n | expected at least one
error = "EX0C"\nvalue_um = 3.0\n | unknown key
"#,
    ) {
        let message = match shop(&format!("[[location]]\n{text}")) {
            Ok(_) => panic!("read: {text}"),
            Err(error) => error.to_string(),
        };
        assert!(message.contains(expected), "{text}: {message}");
        assert!(message.starts_with("shop.toml:"), "{message}");
    }
}

type M = [[f64; 4]; 4];
type V = [f64; 3];

fn product(a: &M, b: &M) -> M {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

/// A rotation by a small vector (rad) and a displacement (mm) about a point, exact to second order.
fn small(e: V, d: V, c: V) -> M {
    let turned = cross(e, c);
    [
        [1.0, -e[2], e[1], d[0] - turned[0]],
        [e[2], 1.0, -e[0], d[1] - turned[1]],
        [-e[1], e[0], 1.0, d[2] - turned[2]],
        [0.0, 0.0, 0.0, 1.0],
    ]
}

fn image(m: &M, p: V) -> V {
    std::array::from_fn(|i| (0..3).map(|k| m[i][k] * p[k]).sum::<f64>() + m[i][3])
}

fn turned(m: &M, u: V) -> V {
    std::array::from_fn(|i| (0..3).map(|k| m[i][k] * u[k]).sum())
}

fn cross(a: V, b: V) -> V {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn plus(a: V, b: V) -> V {
    std::array::from_fn(|i| a[i] + b[i])
}

/// Coefficients of an error in the text of a true machine: those of a polynomial, or a single number; 0 if the error is missing.
fn numbers(truth: &str, name: &str) -> Vec<f64> {
    let line = truth.lines().find_map(|line| line.strip_prefix(&format!("{name} = ")));
    let text = line.unwrap_or("0.0");
    let text = text.trim_start_matches("{ poly = [").trim_end_matches("] }");
    text.split(", ").map(|number| number.parse().expect("a number")).collect()
}

/// Value at 0 and slope of the best-fit line through equally spaced targets over a travel.
fn least_squares(poly: &[f64], length: f64, targets: usize) -> [f64; 2] {
    let x: Vec<f64> = (0..targets).map(|i| length * i as f64 / (targets - 1) as f64).collect();
    let y = x.iter().map(|x| poly.iter().rev().fold(0.0, |sum, c| sum * x + c));
    let y: Vec<f64> = y.collect();
    let n = targets as f64;
    let [mx, my] = [&x, &y].map(|of| of.iter().sum::<f64>() / n);
    let up: f64 = x.iter().zip(&y).map(|(x, y)| (x - mx) * (y - my)).sum();
    let slope = up / x.iter().map(|x| (x - mx).powi(2)).sum::<f64>();
    [my - slope * mx, slope]
}

/// Location errors of the rotary axes of a true machine, as tables of a calibration file.
fn values(truth: &str, structure: &str, targets: usize) -> String {
    let tip = [40.0, -30.0, -150.0];
    let mut before = small([0.0; 3], [0.0; 3], [0.0; 3]);
    let mut lines: Vec<(char, V, V, V)> = Vec::new();
    let mut directions = [[0.0; 3]; 3];
    let (workpiece, tool) = structure.split_once('b').expect("a bed");
    let axes = [(workpiece, false), (tool, true)];
    for (letter, on_tool) in axes
        .iter()
        .flat_map(|(part, on_tool)| part.chars().map(move |c| (c, *on_tool)))
        .filter(|(c, _)| c.is_ascii_uppercase())
    {
        let k = "XYZABC".find(letter).expect("an axis");
        let (own, rotary) = (k % 3, k >= 3);
        let number = |what: String| numbers(truth, &what);
        let (mut delta, mut tilt, mut slope) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        for i in 0..3 {
            let straight = number(format!("E{}{letter}", ["X", "Y", "Z"][i]));
            delta[i] = straight[0] * 1e-3;
            if !rotary && i != own {
                let length = [600.0, 500.0, 400.0][k];
                let line = least_squares(&straight, length, targets);
                (delta[i], slope[i]) = (line[0] * 1e-3, line[1] * 1e-3);
            }
            tilt[i] = number(format!("E{}{letter}", ["A", "B", "C"][i]))[0] * 1e-6;
        }
        let six = |angles: bool| -> V {
            std::array::from_fn(|i| {
                let what = ["X", "Y", "Z", "A", "B", "C"][i + 3 * usize::from(angles)];
                number(format!("E{what}0{letter}"))[0] * if angles { 1e-6 } else { 1e-3 }
            })
        };
        let (off, askew) = (six(false), six(true));
        let point = match letter {
            'A' => [30.0, 250.0, 120.0],
            'B' => [280.0, -20.0, 150.0],
            'C' => [310.0, 240.0, 10.0],
            _ => [0.0; 3],
        };
        let errors = small(tilt, delta, point);
        let mut unit = [0.0; 3];
        unit[own] = 1.0;
        let direction = plus(plus(unit, cross(askew, unit)), slope);
        // Linear axes: M·E on the tool side, E·M on the workpiece side; rotary axes the other way round. At 0, M is the identity.
        if rotary == on_tool {
            before = product(&before, &errors);
        }
        if rotary {
            let line = image(&before, plus(point, off));
            lines.push((letter, line, turned(&before, direction), point));
        } else {
            directions[k] = turned(&before, direction);
        }
        if rotary != on_tool {
            before = product(&before, &errors);
        }
    }
    // The frame of X and Y with its origin at the tip rotates the actual X to (1, 0, 0), and Y into the plane z = 0.
    let [x, y, _] = directions;
    let back = [-y[2], x[2], -x[1]];
    let actual_tip = image(&before, tip);
    let seen = |p: V| {
        let from_tip: V = std::array::from_fn(|i| p[i] - actual_tip[i]);
        plus(tip, plus(from_tip, cross(back, from_tip)))
    };
    let mut tables = String::new();
    for (letter, line, direction, point) in lines {
        let own = "ABC".find(letter).expect("rotary");
        let mut unit = [0.0; 3];
        unit[own] = 1.0;
        let tilt = cross(unit, plus(direction, cross(back, direction)));
        let off = seen(line);
        for i in (0..3).filter(|i| *i != own) {
            let (um, urad) = ((off[i] - point[i]) * 1e3, tilt[i] * 1e6);
            let (d, a) = (["X", "Y", "Z"][i], ["A", "B", "C"][i]);
            writeln!(
                tables,
                "[[location]]\nerror = \"E{d}0{letter}\"\nvalue_um = {um:?}\n[[location]]\nerror = \"E{a}0{letter}\"\nvalue_urad = {urad:?}"
            )
            .expect("a String");
        }
    }
    tables
}

fn of_rotary(structure: &str) -> String {
    let mut errors = String::new();
    for (axis, letter) in ['A', 'B', 'C'].into_iter().enumerate() {
        for (component, what) in ["EX", "EY", "EZ", "EA", "EB", "EC"].into_iter().enumerate() {
            if structure.contains(letter) {
                let wave = |k: f64| ((5 * axis + 7 * component + 2) as f64 * k).sin();
                let c = [7.0 * wave(1.1), 0.1 * wave(0.6), 2e-3 * wave(1.7)];
                writeln!(errors, "{what}{letter} = {{ poly = {c:?} }}").expect("a String");
            }
        }
    }
    errors
}

#[test]
fn a_value_holds_with_all_axes_at_the_reference() {
    for (structure, holds) in [
        ("w C' X' b Y Z B t", true),
        ("w C' A' X' b Y Z t", true),
        ("w X' b Y Z C B t", true),
        ("w C' X' Y' b Z t", false),
        ("w X' C' b B Y Z t", true),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        let (truth, _) = every_error(structure);
        let truth = truth + &of_rotary(structure);
        let mut shop = every_line("", "");
        for letter in ['A', 'B', 'C'].into_iter().filter(|l| structure.contains(*l)) {
            let tilts = format!("\"EA{letter}\", \"EB{letter}\", \"EC{letter}\"");
            for names in [
                tilts.clone(),
                tilts.replace("\"EA", "\"EX").replace("\"EB", "\"EY").replace("\"EC", "\"EZ"),
            ] {
                writeln!(
                    shop,
                    "[[measurement]]\nerrors = [{names}]\nat = {{ X = 300.0, Y = 200.0, Z = 100.0 }}\ncurve = {{ poly = {{ order = 6 }} }}\nholds_location = {holds}"
                )
                .expect("a String");
            }
        }
        let more = values(&truth, structure, 7);
        let (as_it_is, found) = round_trip(folder.path(), &truth, "", &shop, &more);
        let left = compare(&as_it_is, &found.machine, 1000, 4);
        assert!(left.position_um < 0.02, "{structure}: {left:?}");
        for [linear, angular] in [
            ["EY0A\", \"EZ0A", "EB0A\", \"EC0A"],
            ["EX0B\", \"EZ0B", "EA0B\", \"EC0B"],
            ["EX0C\", \"EY0C", "EA0C\", \"EB0C"],
        ] {
            if structure.contains(&linear[3..4]) {
                writeln!(
                    shop,
                    "[[location]]\nerrors = [\"{linear}\"]\n[[location]]\nerrors = [\"{angular}\"]"
                )
                .expect("a String");
            }
        }
        let (truth, found) = round_trip(folder.path(), &truth, "", &shop, "");
        let left = compare(&truth, &found.machine, 1000, 4);
        assert!(left.position_um < 0.02, "{structure}, read by the shop: {left:?}");
    }
}
