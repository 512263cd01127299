//! Wrong calibration files are rejected with file, line and key.

use std::fmt::Write;
use std::fs;

use volcomp_calibrate::{CalibrationFile, calibrate};
use volcomp_metrology::{DeviationUnit, Measurement, Reading, write_renishaw};
use volcomp_test_support::{cases, root};
use volcomp_vocabulary::Direction;

use crate::lab::Lab;

const GOOD: &str = "[[measurement]]\nerror = \"EXX\"\nfile = \"a.csv\"\n";

fn two_axes() -> Lab {
    let lab =
        Lab::new("structure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 100]\nY.travel = [0, 100]\n");
    lab.write("a.csv", "target,deviation\n0,1\n50,2\n100,4\n");
    lab
}

#[test]
fn every_wrong_key_is_reported() {
    let lab = two_axes();
    lab.calibrated(GOOD);
    for [added, expected] in &cases(
        r#"
at = { Z = 1 } | :5: measurement[0].at.Z: the structure
[[measurement]]\nerror = "EYX"\nfile = "a.csv" | :7: measurement[1].file: found "a.csv", which is the file of EXX at
at = { X = 1 } | X is the measured axis
at = { Y = nan } | expected a finite number
at = { Y = 90000 } | :5: measurement[0].at.Y: found 90000 mm, expected a position within the travel of Y, 0 to 100 mm
poitn = [0, 0, 0] | :5: measurement[0].poitn: unknown key
rides = "bus" | expected one of: carriage, other
sign = 2 | expected 1 or -1
method = "magic" | expected one of: direct, angular
method = "angular" | key `bridge_mm` is missing
bridge_mm = 100.0 | expected only with method
unit = "inch" | expected one of: um, µm, mm
curve = "best" | found "best", expected "auto"
curve = { poly = {}, mls = {} } | found 2 kinds of curve
curve = { mls = { auto = true, order = 3 } } | found a setting beside `auto = true`
curve = { poly = { ordr = 2 } } | unknown key
curve = { fourier = {} } | on a rotary axis
[[squareness]]\nerror = "EXX" | squareness[0].error
[[squareness]]\nerror = "EC0Y"\nfrom = ["EXX", "EYX"] | expected ["EXY", "EYX"]
[[squareness]]\nerror = "EC0Y"\nvalue_urad = 1\nreference_angle_urad = 1 | together
holds_location = false | for errors of a rotary axis only
[[measurement]]\nerror = "EXZ"\nfile = "a.csv" | has no axis Z
[[measurement]]\nerror = "EC0Y"\nfile = "a.csv" | squareness has its own table
[[measurement]]\nerror = "EXX"\nfile = "b.csv" | :7: measurement[1].file: 
error = "EYX" | the key `error` appears twice
curve = { poly = {} }\n[[measurement]]\nerror = "EXX"\nfile = "a.csv"\ncurve = { bspline = {} } | another kind of curve for EXX than with
"#,
    ) {
        let read = lab.read(&format!("{GOOD}{added}\n"));
        let message = read.expect_err(added).to_string();
        assert!(message.contains(expected), "{added}: {message}");
    }
    let message = lab.refused(&format!("reference = {{ X = 150 }}\n{GOOD}"));
    assert!(
        message.contains(
            "reference.X: found 150 mm, expected a position within the travel of X, 0 to 100 mm"
        ),
        "{message}"
    );
    let message = lab.refused(&format!("{GOOD}[[squareness]]\nerror = \"EC0Y\"\n"));
    assert!(message.contains("was not measured"), "{message}");
}

#[test]
fn every_wrong_key_of_a_location_is_reported() {
    let lab = two_axes();
    for [added, expected] in &cases(
        r#"
[[location]]\nvalue_um = 1.0 | key `error` or `errors` is missing
[[location]]\nerror = "EC0Y"\nvalue_um = 1.0 | location[0].value_um: EC0Y is in urad, expected the key with the ending _urad
[[location]]\nerror = "EC0Y" | key `value_urad` is missing
[[location]]\nerrors = ["EC0Y"]\nvalues_urad = [1.0, 2.0] | found 2 values, expected 1
[[location]]\nerrors = ["EC0Y", "EC0Y"]\nvalues_urad = [1.0, 2.0] | location[0].errors[1]: EC0Y appears twice
[[location]]\nerror = "EC0X"\nvalue_urad = 1.0 | location[0].error: EC0X is 0 by definition, because X is a reference axis: expected EC0Y
[[location]]\nerror = "EXX"\nvalue_um = 1.0 | found EXX, expected a location error
[[location]]\nerror = "EX0X"\nvalue_um = 1.0 | location[0].error: EX0X 
[[location]]\nerror = "EC0Y"\nvalue_urad = 1.0\nuncertainty_urad = -1 | expected a standard uncertainty of 0 or more
[[squareness]]\nerror = "EC0Y"\nvalue_urad = 1\n[[location]]\nerror = "EC0Y"\nvalue_urad = 1.0 | EC0Y is in [[location]], and [[squareness]] states EC0Y: expected one of them
[[location]]\nerror = "EC0Y"\nvalue_urad = 1\n[[location]]\nerror = "EC0Y"\nvalue_urad = 1.0 | EC0Y is in two [[location]] tables
"#,
    ) {
        let message = lab.refused(&format!("{GOOD}{added}\n"));
        assert!(message.contains(expected), "{added}: {message}");
    }
}

/// Tilts without a position, arc seconds stated as milliradians, and the serial number of another machine are rejected
/// or noted.
#[test]
fn implausible_settings_are_refused_or_noted() {
    let lab = Lab::new(
        "name = \"Mill\"\nstructure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 100]\n",
    );
    let readings = (0..=10).map(|k| Reading {
        target: 100.0 * f64::from(k),
        run: 1,
        direction: Direction::Positive,
        deviation: f64::from(k),
    });
    let mut laser = Measurement {
        unit: Some(DeviationUnit::Um),
        readings: readings.collect(),
        ..Measurement::default()
    };
    laser.metadata.serial = Some("4711".to_owned());
    laser.metadata.machine = Some("Gantry".to_owned());
    lab.write("exx.rtl", &write_renishaw(&laser));
    laser.metadata.serial = Some("4712".to_owned());
    lab.write("other.rtl", &write_renishaw(&laser));
    lab.write("arcsec.csv", "target,deviation mrad\n0,0\n500,2.1\n1000,9.65\n");
    lab.write("tilt.csv", "target,deviation\n0,0\n500,20\n1000,50\n");
    let table = |error: &str, file: &str| {
        format!("[[measurement]]\nerror = \"{error}\"\nfile = \"{file}\"\n")
    };
    for (top, error, file, expected) in [
        ("", "EBX", "arcsec.csv", "found angles that vary by 9.7 mrad, expected less than 5 mrad"),
        (
            "serial = \"4712\"",
            "EXX",
            "exx.rtl",
            "the file states the serial number `4711`, expected `4712`",
        ),
    ] {
        let message = lab.refused(&format!("{top}\n{}", table(error, file)));
        let place = "calibration.toml:5: measurement[0].file: ";
        assert!(message.contains(place) && message.contains(expected), "{message}");
    }
    let tables = table("EBX", "tilt.csv") + &table("EXX", "exx.rtl") + &table("EYY", "other.rtl");
    let warnings = lab.calibrated(&format!("\n{tables}")).warnings.join("\n");
    for expected in [
        "calibration.toml:8): EXX with EBX",
        "calibration.toml:8): it states the machine `Gantry`, and the machine file is of `Mill`",
        "the measurement files state different serial numbers: `4711` (",
    ] {
        assert!(warnings.contains(expected), "{warnings}");
    }
}

#[test]
fn lines_without_a_point_are_listed_in_one_note() {
    let lab = two_axes();
    let readings = "0,0\n25,1\n50,2\n75,3\n100,4\n";
    let mut text = String::new();
    for error in ["EBX", "ECX", "EAY", "EXX", "EYX", "EYY", "EZZ"] {
        lab.write(&format!("{error}.csv"), &format!("target,deviation\n{readings}"));
        if error == "EZZ" {
            continue;
        }
        let point = if error == "EYX" { "point = [0, 0, 9]\n" } else { "" };
        let _ =
            write!(text, "[[measurement]]\nerror = \"{error}\"\nfile = \"{error}.csv\"\n{point}");
    }
    let all = lab.calibrated(&text).warnings;
    let notes: Vec<&String> = all.iter().filter(|note| note.contains("no `point`")).collect();
    assert_eq!(notes.len(), 1, "{all:?}");
    let named = |error: &str, line: usize, tilts: &str| {
        let folder = lab.folder().display();
        format!("{folder}/{error}.csv ({folder}/calibration.toml:{line}): {error} with {tilts}")
    };
    let expected = [named("EXX", 13, "EBX ECX"), named("EYY", 20, "EAY")].join("; ");
    assert!(notes[0].ends_with(&format!("where a line ran elsewhere: {expected}")), "{notes:?}");
}

/// Contradictions between a measurement file and the calibration file. A contradiction that is certainly wrong is
/// rejected with line and key; an implausible one gives a note with the name of the file.
#[test]
fn a_file_that_does_not_fit_its_line_is_refused_or_noted() {
    let lab =
        Lab::new("structure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 100]\n");
    let laser = |axis: &str, machine: &str, step: f64, um: f64| {
        let readings = (0..=10).map(|k| Reading {
            target: step * f64::from(k),
            run: 1,
            direction: Direction::Positive,
            deviation: um * f64::from(k),
        });
        let mut measurement = Measurement {
            unit: Some(DeviationUnit::Um),
            readings: readings.collect(),
            ..Measurement::default()
        };
        measurement.metadata.axis = Some(axis.to_owned());
        measurement.metadata.machine = Some(machine.to_owned());
        write_renishaw(&measurement)
    };
    let read = |files: &[&str]| {
        let mut text = String::new();
        for (file, error) in files.iter().zip(["EXX", "EYY"]) {
            // Writing to a String cannot fail.
            let _ = write!(text, "[[measurement]]\nerror = \"{error}\"\nfile = \"{file}\"\n");
        }
        lab.read(&text)
    };
    lab.write("good.rtl", &laser("X", "Gantry", 100.0, 1.0));
    lab.write("other-axis.rtl", &laser("Y", "Gantry", 100.0, 1.0));
    lab.write("other-axis-in-words.rtl", &laser("y-axis", "Gantry", 100.0, 1.0));
    lab.write("far.csv", "target,deviation\n5000,1\n6000,2\n7000,4\n");
    lab.write("metres.csv", "target,deviation\n0,0\n500,1e6\n1000,2e6\n");
    for (file, expected) in [
        ("other-axis.rtl", "states that axis Y was measured, expected X, the axis of EXX"),
        ("other-axis-in-words.rtl", "states that axis Y was measured, expected X, the axis of EXX"),
        (
            "far.csv",
            "found targets from 5000 to 7000 mm, expected some within the travel of X, 0 to 1000 mm",
        ),
        ("metres.csv", "found a deviation of 2000 mm, expected less than 100 mm"),
    ] {
        let message = read(&[file]).expect_err(file).to_string();
        assert!(message.contains("calibration.toml:4: measurement[0].file: "), "{message}");
        assert!(message.contains(expected), "{message}");
    }
    let warnings = |files: &[&str]| {
        let file = read(files).expect("read");
        assert_eq!(file.files.len(), 2 + files.len());
        calibrate(&file, |_, _| {}).expect("calibrated").warnings.join("\n")
    };
    assert!(!warnings(&["good.rtl"]).contains("good.rtl"));
    lab.write("short.rtl", &laser("X", "Gantry", 40.0, 1.0));
    lab.write("long.rtl", &laser("X", "Gantry", 110.0, 1.0));
    lab.write("mm.rtl", &laser("X", "Gantry", 100.0, 200.0));
    lab.write("mill.rtl", &laser("Y", "Mill", 10.0, 1.0));
    for (files, expected) in [
        (&["short.rtl"][..], "cover 40 % of the travel of X"),
        (&["long.rtl"], "targets from 0 to 1100 mm go beyond the travel of X, 0 to 1000 mm"),
        (&["mm.rtl"], "a deviation of 2000 µm is large"),
        (&["good.rtl", "mill.rtl"], "state different machines: `Gantry` ("),
    ] {
        let message = warnings(files);
        assert!(message.contains(expected), "{files:?}: {message}");
    }
}

/// Targets in the unit of another kind of axis are rejected; units may be written with µ.
#[test]
fn targets_are_in_the_unit_of_the_axis() {
    let lab = two_axes();
    let of = |head: &str, unit: &str| {
        lab.write("a.csv", &format!("{head}\n0,1\n50,2\n100,4\n"));
        lab.read(&format!("{GOOD}{unit}"))
    };
    let error = of("target deg,deviation", "").expect_err("refused").to_string();
    assert!(error.contains("`target deg`") && error.contains("`target mm`"), "{error}");
    for unit in ["um", "µm"] {
        let read = of("target mm,deviation", &format!("unit = \"{unit}\"\n"));
        assert_eq!(read.expect("read").measurements[0].readings.readings[1].deviation, 2.0);
    }
}

/// `unit` may repeat the header's unit, which is applied once; another unit is rejected.
#[test]
fn a_unit_agrees_with_the_header_of_the_file() {
    let lab = two_axes();
    for (header, error, unit, is_read) in [
        ("mm", "EXX", "mm", true),
        ("mm", "EXX", "um", false),
        ("um", "EXX", "um", true),
        ("um", "EXX", "mm", false),
        ("arcsec", "EAX", "arcsec", true),
        ("arcsec", "EAX", "urad", false),
        ("deg", "EAX", "arcsec", false),
    ] {
        let rows = format!("target,deviation {header}\n0,0.001\n50,0.002\n100,0.004\n");
        lab.write("a.csv", &rows);
        let of = |unit: &str| lab.read(&format!("{}{unit}", GOOD.replace("EXX", error)));
        let found = of(&format!("unit = \"{unit}\"\n"));
        let plain = of("").expect("the unit of the header");
        match found {
            Ok(file) => {
                assert!(is_read, "{unit} beside {header} was read");
                let readings = |file: &CalibrationFile| file.measurements[0].readings.clone();
                assert_eq!(readings(&file), readings(&plain), "{unit}");
            }
            Err(message) => {
                let expected = format!(
                    ":5: measurement[0].unit: found \"{unit}\", but the file states that its deviations are in {}",
                    header.replace("um", "µm")
                );
                let message = message.to_string();
                assert!(!is_read && message.contains(&expected), "{message}");
            }
        }
    }
}

/// An impossible angle or length is rejected; an implausible one gives a note.
#[test]
fn stated_values_have_the_size_of_a_machine() {
    let lab = two_axes();
    for [table, expected] in &cases(
        r#"
[[location]]\nerror = "EC0Y"\nvalue_urad = 1e9 | :4: location[0].value_urad: found 1000000 mrad, expected less than 100 mrad
[[squareness]]\nerror = "EC0Y"\nvalue_urad = -2e5 | :4: squareness[0].value_urad: found -200 mrad
[[squareness]]\nerror = "EC0Y"\nreference_angle_urad = 2e5 | squareness[0].reference_angle_urad: found 200 mrad
[[squareness]]\nerror = "EC0Y"\noptical_square_urad = 2e5 | squareness[0].optical_square_urad: found 200 mrad
"#,
    ) {
        let message = lab.refused(table);
        assert!(message.contains(expected), "{message}");
    }
    for table in ["location", "squareness"] {
        let is_noted = |value: f64| {
            let text = format!("[[{table}]]\nerror = \"EC0Y\"\nvalue_urad = {value:?}");
            let notes = lab.calibrated(&text).warnings;
            let expected = format!("EC0Y in [[{table}]]: -1200 µrad is large for a machine tool");
            notes.iter().any(|note| note.starts_with(&expected))
        };
        assert!(is_noted(-1200.0) && !is_noted(-900.0), "{table}");
    }
}

/// A target read in one direction only is rejected: its mean would be wrong by half of the reversal value.
#[test]
fn a_target_that_lacks_a_direction_is_refused() {
    let lab = two_axes();
    let rows = "target,run,direction,deviation\n0,1,+,0\n50,1,+,1\n100,1,+,2\n100,1,-,5\n50,1,-,4\n0,1,-,3\n";
    lab.write("a.csv", rows);
    lab.calibrated(GOOD);
    lab.write("a.csv", &rows.replace("100,1,-,5\n", ""));
    let error = lab.refused(GOOD);
    assert!(error.contains("a.csv: target 100: found no reading in direction -"), "{error}");
    lab.write("a.csv", "target,run,direction,deviation\n0,1,+,0\n50,1,+,1\n100,1,+,2\n");
    lab.calibrated(GOOD);
}

type Truth = fn(f64) -> f64;

/// A wave shorter than two gaps between targets, and a polynomial on clustered targets, give a note with file and axis.
/// Dense targets give no note.
#[test]
fn curves_unsupported_between_targets_are_noted() {
    let even: Vec<f64> = (0..=20).map(|k| 5.0 * f64::from(k)).collect();
    let clustered = [0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 90.0, 92.0, 94.0, 96.0, 98.0, 100.0];
    let cases: [(&[f64], &str, Truth, Option<&str>); 4] = [
        (
            &even,
            "",
            |x| 5.0 * (x / 1.04).sin(),
            Some("the targets are too sparse: left out one at a time they are missed by "),
        ),
        (&even, "", |x| 5.0 * (x / 30.0).sin(), None),
        (&even, "", |_| 0.0, None),
        (
            &clustered,
            "curve = { poly = { order = 9 } }\n",
            |x| x % 4.0 / 2.0,
            Some(
                "between the targets 10 and 90 mm the curve swings by more than a quarter of the height",
            ),
        ),
    ];
    for (targets, curve, truth, expected) in cases {
        let lab = two_axes();
        let mut text = "target,run,direction,deviation\n".to_owned();
        for run in 1..=5_u32 {
            for (index, x) in targets.iter().enumerate() {
                // A scatter of ±0.1 µm without a wave.
                let scatter =
                    0.1 * (f64::from(run * run * 31) + 17.0 * (index * index) as f64).sin();
                let _ = writeln!(text, "{x},{run},+,{}", truth(*x) + scatter);
            }
        }
        lab.write("a.csv", &text);
        let warnings = lab.calibrated(&format!("{GOOD}{curve}")).warnings;
        let notes: Vec<&String> = (warnings.iter())
            .filter(|note| note.contains("sparse") || note.contains("between the targets"))
            .collect();
        match expected {
            Some(said) => assert!(
                notes
                    .iter()
                    .any(|note| note.contains("a.csv: EXX, axis X: ") && note.contains(said)),
                "{warnings:?}"
            ),
            None => assert!(notes.is_empty(), "{notes:?}"),
        }
    }
}

/// The machine of `tests/fuzz/fuzz_targets/calibration.rs`.
const MACHINE: &str = "structure = \"w b X Y C t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.C.travel = [-180.0, 180.0]
";

#[test]
fn calibration_files() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| {
        fs::write(folder.path().join(name), text).expect("written");
    };
    write("machine.toml", MACHINE);
    let mut count = 0;
    for entry in fs::read_dir(root().join("tests/fuzz/corpus/calibration")).expect("a folder") {
        let path = entry.expect("an entry").path();
        let name = path.file_name().expect("a name").display().to_string();
        let text = String::from_utf8_lossy(&fs::read(&path).expect("read")).into_owned();
        let (keys, rows) = text.split_once("\n===\n").unwrap_or((&text, ""));
        write("c.toml", keys);
        write("m.csv", rows);
        let found = CalibrationFile::read(&folder.path().join("c.toml"));
        assert!(found.is_ok() || !name.starts_with("valid-"), "{name}: {found:?}");
        assert!(found.is_err() || !name.starts_with("broken-"), "{name} was read");
        if let Ok(file) = found {
            let _ = calibrate(&file, |_, _| {});
        }
        count += 1;
    }
    assert!(count >= 3, "{count} files");
}
