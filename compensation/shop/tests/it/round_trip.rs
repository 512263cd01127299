//! Round trip of the virtual shop and the calibration: readings come from the whole chain with all errors, while the calibration evaluates
//! single lines by their rules.

use std::{fmt::Write, fs, path::Path};

use volcomp_calibrate::{Calibration, CalibrationFile, Quality, calibrate};
use volcomp_model::Machine;
use volcomp_test_support::rows;
use volcomp_vocabulary::Um;

use crate::{figures::compare, shop_in, write};

/// All errors of three axes: polynomials of order 3 with constants and slopes.
fn truth(structure: &str, axes: &str, more: &str) -> String {
    let mut errors = String::new();
    for (axis, (letter, length)) in
        [("X", 2000.0), ("Y", 1000.0), ("Z", 800.0)].into_iter().enumerate()
    {
        for (component, what) in ["EX", "EY", "EZ", "EA", "EB", "EC"].into_iter().enumerate() {
            // Different signs and sizes, up to about 20 µm and 30 µrad over the travel.
            let seed = (7 * axis + 5 * component + 3) as f64;
            let wave = |k: f64| (seed * k).sin();
            let c = [
                6.0 * wave(1.3),
                20.0 * wave(2.1) / length,
                -25.0 * wave(0.7) / length.powi(2),
                18.0 * wave(3.7) / length.powi(3),
            ];
            writeln!(errors, "{what}{letter} = {{ poly = {c:?} }}").expect("a String");
        }
    }
    format!(
        "name = \"truth\"\nstructure = \"{structure}\"\n[axes]\nX.travel = [0, 2000]\nY.travel = [0, 1000]\n\
         Z.travel = [0, 800]\n{axes}\n[tool]\ntip = [40.0, -30.0, -150.0]\n[errors]\n{errors}\n{more}"
    )
}

const LINES: &str = r#"
machine = "truth.toml"
format = "csv"
seed = 7
[instrument]
runs = 1
alignment_urad = 40.0
[[measurement]]
errors = ["EAX", "EBX", "ECX", "EAY", "EBY", "ECY", "EAZ", "EBZ", "ECZ"]
at = {}
[[measurement]]
error = "EXX"
at = { Y = 300, Z = 400 }
point = [10, 320, 380]
[[measurement]]
errors = ["EYX", "EZX"]
at = { Y = 500, Z = 200 }
point = [100, 520, 180]
rides = "other"
[[measurement]]
error = "EYY"
at = { X = 1200, Z = 650 }
point = [-50, 30, 650]
rides = "other"
[[measurement]]
error = "EYY"
at = { X = 300, Z = 50 }
point = [20, 30, 150]
targets = 17
[[measurement]]
error = "EXY"
at = { X = 700, Z = 100 }
point = [500, 10, 100]
[[measurement]]
error = "EXY"
at = { X = 1500, Z = 300 }
point = [100, 10, 400]
rides = "other"
targets = 12
[[measurement]]
error = "EZY"
at = { X = 700, Z = 100 }
point = [500, 10, 100]
method = "angular"
bridge_mm = 50
sign = -1
[[measurement]]
errors = ["EXZ", "EYZ", "EZZ"]
at = { X = 900, Y = 450 }
point = [850, 500, 60]
[[squareness]]
error = "EC0Y"
reference_angle_urad = -3.2
[[squareness]]
error = "EA0Z"
reference_angle_urad = 5.0
[[squareness]]
error = "EB0Z"
"#;

/// Measures a true machine and calibrates with polynomials of order 3, which are exact for it.
fn round_trip(folder: &Path, truth: &str, lines: &str, more: &str) -> (Machine, Calibration) {
    let shop = shop_in(folder, truth, lines);
    for (name, text) in shop.files(|_, _| {}).expect("measured") {
        let text = match &name[..] {
            "calibration.toml" => {
                more.to_owned()
                    + &text.replace(
                        "[[measurement]]\n",
                        "[[measurement]]\ncurve = { poly = { order = 3 } }\n",
                    )
            }
            _ => text,
        };
        fs::write(folder.join(name), text).expect("written");
    }
    let file = CalibrationFile::read(&folder.join("calibration.toml")).expect("read back");
    (shop.truth, calibrate(&file, |_, _| {}).expect("calibrated"))
}

/// Largest difference between two machines after best-fit rigid-body alignment, which a calibration does not determine.
fn largest_difference_um(one: &Machine, other: &Machine) -> f64 {
    compare(one, other, 300, 6).position_um
}

/// A positioning deviation of an oblique axis has parts along two MCS axes; the calibration reproduces both.
#[test]
fn positioning_of_an_oblique_axis_comes_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let p = [0.0, 0.03, -2e-5, 1e-8];
    let along = |share: f64| p.map(|c| c * share);
    let truth = format!(
        "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 500]\nZ.travel = [0, 500]\n\
         Y = {{ travel = [0, 1000], direction = [0.6, 0.8, 0] }}\n[errors]\n\
         EXY = {{ poly = {:?} }}\nEYY = {{ poly = {:?} }}\n",
        along(0.6),
        along(0.8)
    );
    let lines = "machine = \"truth.toml\"\n[[measurement]]\nerror = \"EYY\"\n";
    let (truth, found) = round_trip(folder.path(), &truth, lines, "");
    assert!(largest_difference_um(&truth, &found.machine) < 1e-4);
    let names: Vec<String> = found.curves.iter().map(|c| c.error.to_string()).collect();
    assert_eq!(names, ["EXY", "EXY", "EYY", "EYY"], "both directions of both");
}

fn small_gantry() -> String {
    volcomp_test_support::machines::gantry([[0.0, 500.0], [0.0, 400.0], [0.0, 300.0]])
}

/// Laser files in two directions with reversal and noise reproduce the curves within the noise of the mean.
#[test]
fn laser_files_with_reversal_and_noise_come_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let errors = "[errors]\nEAX = { poly = [0, 0.1, -1e-4] }\n\
                  EXX = { mean = { poly = [0, 0.05, -1e-4] }, reversal = 6.0 }\n";
    let truth = small_gantry() + errors;
    let lines = "machine = \"truth.toml\"\nseed = 3\n[instrument]\nnoise_um = 0.2\nnoise_urad = 0.2\n\
                 reversal_um = 1.5\nresolution_um = 0.01\n[[measurement]]\nerrors = [\"EAX\", \"EXX\"]\n\
                 [[measurement]]\nerror = \"EXX\"\nboth_directions = false\nat = { Y = 100 }\n";
    let (truth, found) = round_trip(folder.path(), &truth, lines, "");
    for name in ["machine.toml", "eax.rta", "exx.rtl", "exx-2.rtl", "calibration.toml"] {
        assert!(folder.path().join(name).exists(), "{name}");
    }
    // The lost motion of the set-up is indistinguishable from that of the machine.
    let exx = found.curves.iter().find(|c| c.error.to_string() == "EXX");
    let Some(Quality::Length(quality)) = exx.map(|curve| curve.quality) else {
        panic!("EXX is a length");
    };
    let reversal = quality.reversal.expect("two branches");
    assert!((reversal - Um(7.5)).abs() < Um(0.3), "{reversal}");
    let left = largest_difference_um(&truth, &found.machine);
    assert!(left < 0.2, "{left}");
}

#[test]
fn a_shop_repeats_itself_and_lines_do_not_disturb_each_other() {
    let folder = tempfile::tempdir().expect("a folder");
    let files = |lines: &str| {
        let text = format!(
            "machine = \"truth.toml\"\nformat = \"csv\"\n[instrument]\nnoise_um = 1.0\n{lines}"
        );
        shop_in(folder.path(), &small_gantry(), &text).files(|_, _| {}).expect("measured")
    };
    let x = "[[measurement]]\nerror = \"EXX\"\n";
    let one = files(x);
    assert_eq!(one, files(x));
    let two = files(&format!("{x}[[measurement]]\nerror = \"EYX\"\n"));
    assert_eq!(one[1], two[1]);
    assert_ne!(two[1].1, two[2].1, "noise of their own");
}

#[test]
fn every_error_comes_back_on_every_three_axis_structure() {
    for [structure, axes, reference] in rows(
        r#"
w X' b Y Z t |  |
w X' Y' b Z t |  |
w b X Y Z t |  |
w X' Y' Z' b t |  | reference_axes = ["Y", "Z"]\n
w Y' b Z X t | Y.point = [20, -40, 30]\nX.point = [5, 6, 7] | reference_axes = ["Z", "X"]\n
w X' b Y Z t | X.direction = [-1, 0, 0]\nY.direction = [0, -1, 0] |
"#,
    ) {
        let folder = tempfile::tempdir().expect("a folder");
        let truth = truth(structure, axes, "EC0Y = 12.0\nEA0Z = -7.0\nEB0Z = 9.0\n");
        let (truth, found) = round_trip(folder.path(), &truth, LINES, reference);
        let left = largest_difference_um(&truth, &found.machine);
        let mut without = found.machine.clone();
        without.clear_errors();
        let before = largest_difference_um(&truth, &without);
        assert!(before > 20.0, "{structure} {axes}: nothing to measure: {before}");
        assert!(left < 5e-3, "{structure} {axes} {reference}: {left} of {before}");
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
    }
}

/// EX0C = 40 µm moves the point under an indicator by 40·(cos C − 1) µm along X. An instrument centred on the axis does not measure this,
/// and its calibration file states so.
#[test]
fn an_instrument_centred_on_the_axis_does_not_see_where_the_axis_lies() {
    const TRUTH: &str = "structure = \"w C' X' b Y Z t\"
axes = { X = { travel = [0, 500] }, Y = { travel = [0, 400] }, Z = { travel = [0, 300] }, C = { travel = [-90, 90] } }
tool = { tip = [0, 0, 0] }
errors = { EX0C = 40.0 }
";
    for (key, expected) in [("", 40.0), ("holds_location = false\n", 0.0)] {
        let folder = tempfile::tempdir().expect("a folder");
        let lines = format!(
            "machine = \"truth.toml\"\nseed = 1\ninstrument = {{ noise_um = 0.0, noise_urad = 0.0, alignment_urad = 0.0 }}\n[[measurement]]\nerrors = [\"EXC\"]\nat = {{ X = 0.0, Y = 0.0, Z = 0.0 }}\n{key}"
        );
        write(&shop_in(folder.path(), TRUTH, &lines), folder.path());
        let file = CalibrationFile::read(&folder.path().join("calibration.toml")).expect("read");
        assert_eq!(file.measurements[0].holds_location, key.is_empty());
        let readings = &file.measurements[0].readings.readings;
        let largest = readings.iter().map(|reading| reading.deviation.abs()).fold(0.0, f64::max);
        assert!((largest - expected).abs() < 0.1, "{key}: {largest}");
    }
}
