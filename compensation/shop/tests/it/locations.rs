//! Location errors that are measured directly, and their entries in the calibration file.

use std::{fs, path::Path};

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_model::Machine;
use volcomp_shop::{Shop, ShopError};
use volcomp_test_support::rows;
use volcomp_vocabulary::ErrorName;

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
    for (name, text) in shop(text).expect("valid").files(|_, _| {}).expect("made") {
        fs::write(folder.join(name), text).expect("written");
    }
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
