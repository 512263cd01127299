//! `--uncertainty` from observations, of the map and of corrections.

use std::fs;

use crate::{Folder, contains, float, json, refused, refuses, root, text, volcomp};

const OBSERVATIONS: &str = "examples/identification/observations.toml";
const TRIALS: &str = "120";

fn identified(folder: &Folder) -> String {
    let machine = folder.file("found.toml");
    json(&["identify", OBSERVATIONS, "-o", &machine]);
    machine
}

/// The three standard uncertainties of position at each node of the map, µm.
fn mapped(machine: &str, from: &str, csv: &std::path::Path) -> Vec<[f64; 3]> {
    let csv = csv.display().to_string();
    json(&format!("map -m {machine} --grid 3x3x2 --trials {TRIALS} --uncertainty {from} -o {csv}"));
    let text = fs::read_to_string(csv).expect("written");
    let row = |line: &str| {
        let numbers: Vec<f64> = line.split(',').map(|n| n.parse().expect("a number")).collect();
        [numbers[9], numbers[10], numbers[11]]
    };
    text.lines().skip(1).map(row).collect()
}

/// Samples from the covariance agree with repeated identifications from resampled readings. A calibration key in the
/// file selects the repeated identifications.
#[test]
fn bands_of_the_covariance_are_those_of_repeated_identifications() {
    let folder = Folder::new();
    let machine = identified(&folder);
    let examples = root().join("examples/identification");
    for entry in fs::read_dir(&examples).expect("a folder") {
        let path = entry.expect("an entry").path();
        fs::copy(&path, folder.path().join(path.file_name().expect("a name"))).expect("copied");
    }
    let observations = fs::read_to_string(root().join(OBSERVATIONS)).expect("read");
    let again = folder.path().join("again.toml");
    let calibration = format!("{observations}\n[uncertainty]\nreading_um = 0.0\n");
    fs::write(&again, calibration).expect("written");
    let drawn = mapped(&machine, OBSERVATIONS, &folder.path().join("drawn.csv"));
    let again = again.display().to_string();
    let repeated = mapped(&machine, &again, &folder.path().join("repeated.csv"));
    assert_eq!(drawn.len(), 18);
    // Four standard deviations of the ratio of two standard deviations, each from 120 samples.
    let allowed = 4.0 / 120.0_f64.sqrt();
    for (drawn, repeated) in drawn.iter().flatten().zip(repeated.iter().flatten()) {
        assert!(*repeated > 0.05, "{repeated}");
        assert!((drawn / repeated - 1.0).abs() < allowed, "{drawn} {repeated}");
    }
}

/// If only X, Y and Z correct, the correction is the negative position error with the same uncertainty.
#[test]
fn a_correction_of_linear_axes_is_as_uncertain_as_the_error() {
    let folder = Folder::new();
    let machine = identified(&folder);
    let nodes = mapped(&machine, OBSERVATIONS, &folder.path().join("map.csv"));
    let output = folder.file("c.csv");
    let at = ["--at", "X=2100,Y=1200,Z=600", "--axes", "X,Y,Z"];
    let from = ["--uncertainty", OBSERVATIONS, "--trials", TRIALS];
    let call = [&["correct", "-m", &machine, "-o", &output], &at[..], &from[..]].concat();
    let answer = json(&call);
    let uncertainty = &answer["uncertainty"];
    let last = nodes.last().expect("nodes");
    for (axis, expected) in ["X", "Y", "Z"].into_iter().zip(last) {
        let found = float(&uncertainty[axis]);
        assert!((found / expected - 1.0).abs() < 1e-2, "{axis}: {found} {expected}");
    }
    // Axes that `--axes` excludes are not corrected, so their uncertainty is zero.
    assert_eq!(float(&uncertainty["B"]), 0.0);
    let csv = fs::read_to_string(&output).expect("written");
    let mut lines = csv.lines().map(|line| line.split(','));
    let (names, mut cells) = (lines.next().expect("names"), lines.next().expect("a row"));
    let place = names.into_iter().position(|n| n == "Y_u_correction_um");
    let cell = cells.nth(place.expect("a column")).expect("a cell");
    let cell: f64 = cell.parse().expect("a number");
    assert!((cell - float(&uncertainty["Y"])).abs() < 1e-8);
    let shown = text(&call);
    contains(&shown, "corrected");
    contains(&shown, " u\n");
    let without = json(&[&["correct", "-m", &machine][..], &at[..]].concat());
    assert!(without.get("uncertainty").is_none());
}

fn notes(call: &str) -> Vec<String> {
    let output = volcomp(call);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(0), "{said}");
    // Continuation lines of a note are indented.
    let mut notes: Vec<String> = Vec::new();
    for line in said.lines() {
        match (line.strip_prefix("note: "), notes.last_mut()) {
            (Some(note), _) => notes.push(note.to_owned()),
            (None, Some(last)) => *last = format!("{last} {}", line.trim_start()),
            (None, None) => {}
        }
    }
    notes
}

/// The uncertainty of a map names the unmeasured errors, from a calibration and from observations.
#[test]
fn what_nothing_measured_is_named() {
    let folder = Folder::new();
    let machine = folder.file("m.toml");
    let calibration = "examples/calibration/calibration.toml";
    let of_calibration = notes(&format!("calibrate {calibration} -o {machine}"));
    let from =
        |file| notes(&format!("map -m {machine} --grid 2x2x2 --trials 2 --uncertainty {file}"));
    let of_map = from(calibration);
    let not_measured =
        |note: &&String| note.contains("not measured") && note.contains("taken as 0");
    let expected: Vec<&String> = of_calibration.iter().filter(not_measured).collect();
    assert!(expected.len() > 3, "{of_calibration:?}");
    for note in expected {
        assert!(of_map.contains(note), "{note}: {of_map:?}");
    }
    let heading = "errors that were not measured are in the uncertainty as if they were known";
    assert_eq!(of_map.iter().filter(|note| *note == heading).count(), 1);
    let machine = "examples/identification/machine.toml";
    let of_observations =
        notes(&format!("map -m {machine} --grid 2x2x2 --trials 2 --uncertainty {OBSERVATIONS}"));
    // The unknowns of the file are EYX, EBX and EXX of X, and all location errors but EA0B.
    assert!(
        of_observations.contains(&"not measured, taken as 0: EZX EAX ECX".to_owned()),
        "{of_observations:?}"
    );
    let single: Vec<&str> = of_observations
        .iter()
        .filter_map(|note| note.split_once(" was not measured and is").map(|(name, _)| name))
        .collect();
    assert!(single.contains(&"EA0B") && !single.contains(&"EC0B"), "{single:?}");
}

#[test]
fn observations_of_another_machine_are_refused() {
    let call = ["-m", "examples/five-axis.toml", "--at", "X=1"];
    let from = ["--uncertainty", OBSERVATIONS];
    refuses(
        &[&["correct"], &call[..], &from[..]].concat(),
        "found the structure `w b X Y Z C B t`",
    );
    refuses(&[&["correct"], &call[..], &["--trials", "5"]].concat(), "--uncertainty");
}

fn said(machine: &str, from: &str) -> String {
    crate::notes(&format!("map -m {machine} --grid 2x2x2 --trials 4 --uncertainty {from}"))
}

/// The text of a machine file with one change, and without the checksums, which would no longer match.
fn with_change(text: &str, from: &str, to: &str) -> String {
    assert!(text.contains(from), "{from}\n{text}");
    let changed = text.replacen(from, to, 1);
    let lines = changed.lines().filter(|line| !line.contains("sha256"));
    lines.collect::<Vec<_>>().join("\n")
}

/// A machine that does not result from the observations gets a note that names the difference: its name, the values of
/// its errors, or the point of an axis.
#[test]
fn a_file_that_did_not_make_the_machine_is_noted() {
    let folder = Folder::new();
    let machine = identified(&folder);
    let own = said(&machine, OBSERVATIONS);
    assert!(!own.contains("was not made from") && !own.contains("is of the machine"), "{own}");

    let text = fs::read_to_string(&machine).expect("written");
    let other = folder.file("other.toml");
    let changed = |from: &str, to: &str| {
        fs::write(&other, with_change(&text, from, to)).expect("written");
    };
    changed("fork-head", "another");
    let words = said(&other, OBSERVATIONS);
    contains(&words, "is of the machine \"fork-head\", --machine is \"another\"");
    // Two location errors are changed, one at a time. The other errors agree.
    let value = |name: &str| -> f64 {
        let line = text.lines().find(|line| line.starts_with(&format!("{name} = ")));
        let line = line.expect("the error");
        line.split('=').nth(1).and_then(|v| v.trim().parse().ok()).expect("a number")
    };
    for name in ["EC0Y", "EB0C"] {
        let found = value(name);
        let line = format!("{name} = {found:?}");
        changed(&line, &format!("{name} = {:?}", found + 7.0));
        let words = said(&other, OBSERVATIONS);
        assert!(
            words.contains("was not made from")
                && words.contains(&format!("at most {name} by 7.00 µrad;")),
            "{words}"
        );
        let words = String::from_utf8(
            volcomp(&format!(
                "correct -m {other} --at X=100 --trials 4 --uncertainty {OBSERVATIONS}"
            ))
            .stderr,
        )
        .expect("UTF-8");
        contains(&words, "was not made");
    }
    // A machine with another point of an axis is another machine.
    let output = {
        changed("400.0]", "410.0]");
        refused(&format!("map -m {other} --grid 2x2x2 --uncertainty {OBSERVATIONS}"))
    };
    contains(&output, "point of axis");
}

/// A machine that does not result from the calibration gets a note that names a changed curve, or an error that the
/// file does not measure.
#[test]
fn a_calibration_that_did_not_make_the_machine_is_noted() {
    let folder = Folder::new();
    let path = folder.path();
    let shop = "examples/calibration/shop.toml";
    json(&["simulate", shop, "-o", path.to_str().expect("UTF-8")]);
    let calibration = path.join("calibration.toml").display().to_string();
    let machine = path.join("made.toml").display().to_string();
    json(&["calibrate", &calibration, "-o", &machine]);
    let own = said(&machine, &calibration);
    assert!(!own.contains("was not made from"), "{own}");
    let text = fs::read_to_string(&machine).expect("written");
    let lines: Vec<String> = text
        .lines()
        .filter(|line| !line.contains("sha256"))
        .map(|line| match line.strip_prefix("EYY = ") {
            Some(_) => "EYY = 3.0".to_owned(),
            None => line.to_owned(),
        })
        .collect();
    let other = path.join("other.toml").display().to_string();
    fs::write(&other, lines.join("\n")).expect("written");
    let words = said(&other, &calibration);
    contains(&words, "was not made from");
    contains(&words, "at most EYY by");
    // Errors stated at another point of a linear axis, and a machine with another travel.
    for (from, to, expected) in [
        ("point = [0.0, 0.0, -650.0]", "point = [0.0, 0.0, -600.0]", "(point of X)"),
        ("travel = [0.0, 400.0]", "travel = [0.0, 390.0]", "(travel of Y)"),
    ] {
        fs::write(&other, with_change(&text, from, to)).expect("written");
        let words = said(&other, &calibration);
        contains(&words, expected);
    }
    // Assembly errors and thermal terms that the calibration does not give.
    let unsigned = text.lines().filter(|line| !line.contains("sha256") && *line != "[assembly]");
    let unsigned = unsigned.collect::<Vec<_>>().join("\n");
    for (table, expected) in [
        (
            "[assembly]\nX = [0.0, 2.0, 0.0, 7.0, 0.0, 0.0]",
            "its machine has other [assembly] errors than --machine (EA of X by 7.00 µrad)",
        ),
        (
            "[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale\"\num_per_m_k = 8.0\n",
            "its machine has other [thermal] terms than --machine",
        ),
    ] {
        fs::write(&other, format!("{unsigned}\n{table}\n")).expect("written");
        let words = said(&other, &calibration);
        contains(&words, expected);
        assert!(!own.contains(&expected[..30]), "{own}");
    }
}
