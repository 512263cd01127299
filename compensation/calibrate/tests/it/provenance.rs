//! Provenance of errors in the calibrated machine.

use std::{fmt::Write as _, fs};

use crate::lab::Lab;

/// The best-fit line is constant at 0.4: the residuals alternate between −0.4 and 0.6.
const ZIGZAG: &str = "target,deviation_um\n0,0\n25,1\n50,0\n75,1\n100,0\n";
/// Output of `sha256sum` for ZIGZAG.
const HASH: &str = "b9af90ed6d5058fb6b01448ab165fd6962ec85b08a981b326ff5500030b11f7d";
const MACHINE: &str =
    "structure = \"w X' b Y t\"\n[axes]\nX.travel = [0, 100]\nY.travel = [0, 100]\n";
const CALIBRATION: &str = "serial = \"GM-17\"\n\
    [[measurement]]\nerror = \"EXX\"\nfile = \"lasers/x.csv\"\nat = { Y = 40 }\ncurve = { poly = { order = 1 } }\n\
    [[measurement]]\nerror = \"EYX\"\nfile = \"eyx.csv\"\n\
    [[measurement]]\nerror = \"EXY\"\nfile = \"exy.csv\"\n\
    [[squareness]]\nerror = \"EC0Y\"\nfrom = [\"EXY\", \"EYX\"]\nreference_angle_urad = 0\n";

fn files(machine: &str) -> Lab {
    let lab = Lab::new(machine);
    fs::create_dir_all(lab.folder().join("lasers")).expect("made");
    lab.write("lasers/x.csv", ZIGZAG);
    lab.write("eyx.csv", "target,deviation_um\n0,0\n25,2\n50,3\n75,2\n100,0\n");
    lab.write("exy.csv", "target,deviation_um\n0,0\n25,1\n50,4\n75,1\n100,0\n");
    lab
}

/// Residual and leave-one-out error equal the values computed by hand: a line through five equally spaced targets has
/// the leverages 0.6, 0.3, 0.2, 0.3, 0.6.
#[test]
fn a_curve_has_the_provenance_and_quality_of_its_file() {
    let found = files(MACHINE).calibrated(CALIBRATION);
    let provenance = found.machine.provenance();
    assert_eq!(provenance.serial.as_deref(), Some("GM-17"));
    assert_eq!(provenance.date, None);
    assert_eq!(provenance.version.as_deref(), Some(env!("CARGO_PKG_VERSION")));
    let of = |name: &str| {
        let error = name.parse().expect("a name");
        provenance.of(error).unwrap_or_else(|| panic!("{name}"))
    };
    let exx = of("EXX");
    assert_eq!(exx.method, "polynomial of order 1");
    assert_eq!(exx.rule.as_deref(), Some("stated in the calibration file"));
    let near = |found: Option<f64>, expected: f64| {
        let found = found.expect("a number");
        assert!((found - expected).abs() < 1e-6, "{found} {expected}");
    };
    near(exx.residual, 0.24_f64.sqrt());
    let squares = [0.4 / 0.4, 0.6 / 0.7, 0.4 / 0.8, 0.6 / 0.7, 0.4 / 0.4_f64];
    let squares: f64 = squares.iter().map(|error| error * error).sum();
    near(exx.leave_one_out, (squares / 5.0).sqrt());
    let [source] = &exx.sources[..] else { panic!("{:?}", exx.sources) };
    assert_eq!((source.file.as_str(), source.sha256.as_str()), ("lasers/x.csv", HASH));
    assert_eq!((source.runs, source.targets), (Some(1), Some(5)));
    let at: Vec<(String, f64)> = source.at.iter().map(|(n, q)| (n.to_string(), *q)).collect();
    assert_eq!(at, [("Y".to_owned(), 40.0)]);
    let square = of("EC0Y");
    assert_eq!(square.method, "slopes of EXY and EYX");
    let files: Vec<&str> = square.sources.iter().map(|s| s.file.as_str()).collect();
    assert_eq!(files, ["exy.csv", "eyx.csv"]);
    assert!(!of("EYX").rule.as_deref().unwrap_or_default().contains("stated"));
}

#[test]
fn the_same_files_give_the_same_bytes() {
    let calibrated = |machine: &str| files(machine).calibrated(CALIBRATION).machine;
    let text = calibrated(MACHINE).to_toml();
    assert!(text.contains("[provenance]") && text.contains(HASH), "{text}");
    assert_eq!(calibrated(MACHINE).to_toml(), text);
    // Errors that are measured again get a new provenance; others keep theirs.
    let other = text.replace("EXX", "EZY");
    let other: String = other.lines().filter(|l| !l.starts_with("checksum")).fold(
        String::new(),
        |mut text, line| {
            let _ = writeln!(text, "{line}");
            text
        },
    );
    let again = calibrated(&other);
    let names: Vec<String> =
        (again.provenance().errors.iter()).map(|origin| origin.error.to_string()).collect();
    assert_eq!(names.iter().filter(|name| *name == "EYX").count(), 1, "{names:?}");
    assert!(names.contains(&"EZY".to_owned()) && names.contains(&"EXX".to_owned()), "{names:?}");
}

#[test]
fn a_file_is_listed_once_for_an_error() {
    let twice = format!(
        "{CALIBRATION}[[measurement]]\nerror = \"EYX\"\nfile = \"./lasers/../eyx.csv\"\nat = {{ Y = 50 }}\n"
    );
    let message = files(MACHINE).refused(&twice);
    assert!(
        message.contains("found `./lasers/../eyx.csv`, which")
            && message.contains("for EYX already"),
        "{message}"
    );
}

/// A wave of 50 µm with a zigzag of 0.3 µm, ten times the scatter of the runs, gives a note: only a table follows the
/// zigzag, but its leave-one-out error exceeds a micrometre, so a curve of few terms is chosen. Offsets and slopes of
/// the runs have no effect.
#[test]
fn a_curve_that_does_not_follow_its_readings_is_noted() {
    let readings = |zigzag: f64, alignment: f64| {
        let mut text = String::from("target,run,direction,deviation_um\n");
        for run in 1..=4 {
            for step in 0..=20 {
                let sign = |odd: i32| if odd % 2 == 0 { 1.0 } else { -1.0 };
                let wave = 50.0 * (std::f64::consts::TAU * f64::from(step) / 20.0).sin();
                let scatter = 0.02 * sign(run / 2 + step / 3) * sign(run);
                let line = alignment * (f64::from(run) - 2.0) * (1.0 - f64::from(step) / 10.0);
                let value = wave + zigzag * sign(step) + scatter + line;
                let _ = writeln!(text, "{},{run},+,{value}", step * 5);
            }
        }
        text
    };
    let lab = Lab::new(MACHINE);
    let is_noted = |zigzag: f64, alignment: f64| {
        lab.write("x.csv", &readings(zigzag, alignment));
        let found = lab.calibrated("[[measurement]]\nerror = \"EXX\"\nfile = \"x.csv\"\n");
        let said = found.warnings.iter().any(|w| w.starts_with("EXX: the curve chosen"));
        let rule = found.machine.provenance().errors[0].rule.clone();
        (said, rule.unwrap_or_default().contains("does not follow"))
    };
    for alignment in [0.0, 5.0] {
        assert_eq!(is_noted(0.3, alignment), (true, true), "{alignment}");
        assert_eq!(is_noted(0.0, alignment), (false, false), "{alignment}");
    }
}

/// A straightness that is 1000 times too large gives a note, and the correct one does not; both contain the slope of
/// the beam.
#[test]
fn a_straightness_in_the_wrong_unit_is_noted() {
    let lab = Lab::new(MACHINE);
    let is_noted = |scale: f64| {
        let mut text = String::from("target,deviation_um\n");
        for step in 0..=10 {
            let x = f64::from(step) / 10.0;
            let _ = writeln!(text, "{},{}", 10 * step, 900.0 * x + scale * 8.0 * x * (1.0 - x));
        }
        lab.write("e.csv", &text);
        let found = lab.calibrated("[[measurement]]\nerror = \"EYX\"\nfile = \"e.csv\"\n");
        found.warnings.iter().any(|w| w.contains("a deviation of"))
    };
    assert!(is_noted(1000.0));
    assert!(!is_noted(1.0));
}
