//! `--uncertainty` from observations: of the map, and of corrections.

use std::fs;

use serde_json::Value;

use crate::{json, refused, root, text};

const OBSERVATIONS: &str = "examples/identification/observations.toml";
const TRIALS: &str = "120";

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap_or(f64::NAN)
}

/// A machine file of what the observations of the example show.
fn identified(folder: &std::path::Path) -> String {
    let machine = folder.join("found.toml").display().to_string();
    json(&["identify", OBSERVATIONS, "-o", &machine]);
    machine
}

/// The three uncertainties of position at every node of the map, µm.
fn mapped(machine: &str, from: &str, csv: &std::path::Path) -> Vec<[f64; 3]> {
    let csv = csv.display().to_string();
    json(&[
        "map",
        "-m",
        machine,
        "--grid",
        "3x3x2",
        "--trials",
        TRIALS,
        "--uncertainty",
        from,
        "-o",
        &csv,
    ]);
    let text = fs::read_to_string(csv).expect("written");
    let row = |line: &str| {
        let numbers: Vec<f64> = line
            .split(',')
            .map(|n| n.parse().expect("a number"))
            .collect();
        [numbers[9], numbers[10], numbers[11]]
    };
    text.lines().skip(1).map(row).collect()
}

/// The covariance against the whole identification, repeated with readings drawn again: a file with a key of calibrations
/// is one whose readings are drawn.
#[test]
fn bands_of_the_covariance_are_those_of_repeated_identifications() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let machine = identified(folder);
    let examples = root().join("examples/identification");
    for entry in fs::read_dir(&examples).expect("a folder") {
        let path = entry.expect("an entry").path();
        fs::copy(&path, folder.join(path.file_name().expect("a name"))).expect("copied");
    }
    let observations = fs::read_to_string(root().join(OBSERVATIONS)).expect("read");
    let again = folder.join("again.toml");
    let calibration = format!("{observations}\n[uncertainty]\nreading_um = 0.0\n");
    fs::write(&again, calibration).expect("written");
    let drawn = mapped(&machine, OBSERVATIONS, &folder.join("drawn.csv"));
    let again = again.display().to_string();
    let repeated = mapped(&machine, &again, &folder.join("repeated.csv"));
    assert_eq!(drawn.len(), 18);
    // Four standard deviations of the ratio of two spreads over 120 draws each.
    let allowed = 4.0 / 120.0_f64.sqrt();
    for (drawn, repeated) in drawn.iter().flatten().zip(repeated.iter().flatten()) {
        assert!(*repeated > 0.05, "{repeated}");
        assert!(
            (drawn / repeated - 1.0).abs() < allowed,
            "{drawn} {repeated}"
        );
    }
}

/// Where only X, Y and Z correct, the correction is minus the position error: it is as uncertain.
#[test]
fn a_correction_of_linear_axes_is_as_uncertain_as_the_error() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let machine = identified(folder);
    let nodes = mapped(&machine, OBSERVATIONS, &folder.join("map.csv"));
    let output = folder.join("c.csv").display().to_string();
    let at = ["--at", "X=2100,Y=1200,Z=600", "--axes", "X,Y,Z"];
    let from = ["--uncertainty", OBSERVATIONS, "--trials", TRIALS];
    let call = [
        &["correct", "-m", &machine, "-o", &output],
        &at[..],
        &from[..],
    ]
    .concat();
    let answer = json(&call);
    let uncertainty = &answer["uncertainty"];
    let last = nodes.last().expect("nodes");
    for (axis, expected) in ["X", "Y", "Z"].into_iter().zip(last) {
        let found = number(&uncertainty[axis]);
        assert!(
            (found / expected - 1.0).abs() < 1e-2,
            "{axis}: {found} {expected}"
        );
    }
    // Axes that are held are not corrected.
    assert_eq!(number(&uncertainty["B"]), 0.0);
    let csv = fs::read_to_string(&output).expect("written");
    let mut lines = csv.lines().map(|line| line.split(','));
    let (names, mut cells) = (lines.next().expect("names"), lines.next().expect("a row"));
    let place = names.into_iter().position(|n| n == "Y_u_correction_um");
    let cell = cells.nth(place.expect("a column")).expect("a cell");
    let cell: f64 = cell.parse().expect("a number");
    assert!((cell - number(&uncertainty["Y"])).abs() < 1e-8);
    let shown = text(&call);
    assert!(
        shown.contains("corrected") && shown.contains(" u\n"),
        "{shown}"
    );
    let without = json(&[&["correct", "-m", &machine][..], &at[..]].concat());
    assert!(without.get("uncertainty").is_none());
}

#[test]
fn observations_of_another_machine_are_refused() {
    let call = ["-m", "examples/five-axis.toml", "--at", "X=1"];
    let from = ["--uncertainty", OBSERVATIONS];
    let message = refused(&[&["correct"], &call[..], &from[..]].concat());
    assert!(
        message.contains("found the structure `w b X Y Z C B t`"),
        "{message}"
    );
    let message = refused(&[&["correct"], &call[..], &["--trials", "5"]].concat());
    assert!(message.contains("--uncertainty"), "{message}");
}
