//! Linear axes on both sides of `b`: some axes have their straightness references on the table, others on the tool.
//!
//! Slopes due to rotary axes, kept constants and assembly errors do not count as squareness.

use std::{collections::BTreeMap, fmt::Write as _, fs, path::Path};

use volcomp_calibrate::{Calibration, CalibrationFile, calibrate};
use volcomp_model::Machine;

use crate::{figures::compare, shop_in};

const COMPONENTS: [&str; 6] = ["EX", "EY", "EZ", "EA", "EB", "EC"];
const SQUARES: &str = "[[squareness]]\nerror = \"EC0Y\"\nreference_angle_urad = -3.0\n[[squareness]]\nerror = \"EA0Z\"\nreference_angle_urad = 5.0\n[[squareness]]\nerror = \"EB0Z\"\n";

/// Three linear axes, and the rotary axes of the structure.
fn geometry(structure: &str) -> String {
    let mut text = format!(
        "structure = \"{structure}\"\n[axes]\nX.travel = [0, 600]\nY.travel = [0, 500]\nZ.travel = [0, 400]\n"
    );
    for (letter, point) in
        [('A', [30.0, 250.0, 120.0]), ('B', [280.0, -20.0, 150.0]), ('C', [310.0, 240.0, 10.0])]
    {
        if structure.contains(letter) {
            writeln!(text, "{letter} = {{ travel = [-90, 90], point = {point:?} }}")
                .expect("a String");
        }
    }
    text + "[tool]\ntip = [40.0, -30.0, -150.0]\n"
}

/// Simulates the lines of a shop on a true machine, and calibrates a machine file that keeps some of its errors. `more` is appended to the
/// calibration file.
pub(crate) fn round_trip(
    folder: &Path,
    truth: &str,
    kept: &str,
    shop: &str,
    more: &str,
) -> (Machine, Calibration) {
    let shop = shop_in(folder, truth, shop);
    let mut files: BTreeMap<String, String> =
        shop.files(|_, _| {}).expect("measured").into_iter().collect();
    if let Some(observations) = files.remove("observations.toml") {
        let (head, tables) = observations.split_once("[[observation]]").expect("an observation");
        let unknown = head.find("unknown").expect("unknowns");
        let calibration = &files["calibration.toml"];
        let merged = format!("{}\n{calibration}\n[[observation]]{tables}", &head[unknown..]);
        files.insert("calibration.toml".to_owned(), merged);
    }
    if !kept.is_empty() {
        files.insert("machine.toml".to_owned(), kept.to_owned());
    }
    if let Some(calibration) = files.get_mut("calibration.toml") {
        calibration.push_str(more);
    }
    for (name, text) in &files {
        fs::write(folder.join(name), text).expect("written");
    }
    let file = CalibrationFile::read(&folder.join("calibration.toml")).expect("read back");
    (shop.truth, calibrate(&file, |_, _| {}).expect("calibrated"))
}

fn straight_lines() -> String {
    format!(
        "machine = \"truth.toml\"\nformat = \"csv\"\n[instrument]\nruns = 1\ntargets = 5\nboth_directions = false\nalignment_urad = 40.0\n\
         [[measurement]]\nerrors = [\"EYX\", \"EZX\", \"EXY\", \"EZY\", \"EXZ\", \"EYZ\"]\ncurve = {{ poly = {{ order = 2 }} }}\n{SQUARES}"
    )
}

const BOTH_SIDES: [&str; 5] = [
    "w X' b Y Z C B t",
    "w C' B' X' Y' b Z t",
    "w C' X' b Y Z B t",
    "w Y' A' b X C Z t",
    "w X' C' b B Y Z t",
];
const TILTS: &str = "EC0Y = 22.0\nEA0Z = -15.0\nEB0Z = 9.0\n";

/// Constants that a machine file keeps are in the readings and must not count as squareness again: less than 0.02 µm remain.
#[test]
fn constants_that_are_kept_are_no_squareness() {
    for structure in BOTH_SIDES {
        let folder = tempfile::tempdir().expect("a folder");
        let mut constants = String::new();
        for (name, value) in [
            ("ECC", 100.0),
            ("EAC", -60.0),
            ("EBC", 30.0),
            ("ECB", 40.0),
            ("EAB", 25.0),
            ("EBB", -80.0),
            ("EAA", 35.0),
            ("ECA", -45.0),
        ] {
            if structure.contains(&name[2..]) {
                writeln!(constants, "{name} = {value:?}").expect("a String");
            }
        }
        let kept = format!("{}[errors]\n{constants}", geometry(structure));
        let truth = format!("{kept}{TILTS}");
        let (truth, found) = round_trip(folder.path(), &truth, &kept, &straight_lines(), "");
        let left = compare(&truth, &found.machine, 300, 1);
        assert!(left.position_um < 0.02, "{structure}: {left:?}");
    }
}

/// Constant angles of `[assembly]` that the machine file keeps do not count as squareness: less than 0.02 µm remain.
#[test]
fn assembly_angles_that_are_kept_are_no_squareness() {
    for structure in BOTH_SIDES {
        let folder = tempfile::tempdir().expect("a folder");
        let mut assembly = String::from("[assembly]\n");
        for (letter, six) in [
            ('X', [3.0, -2.0, 5.0, 40.0, -70.0, 55.0]),
            ('Y', [-4.0, 2.0, 1.0, -35.0, 60.0, 80.0]),
            ('Z', [6.0, 1.0, -3.0, 45.0, 30.0, -65.0]),
            ('A', [2.0, 3.0, -6.0, 25.0, 55.0, 40.0]),
            ('B', [1.0, -7.0, 2.0, -50.0, 35.0, 60.0]),
            ('C', [5.0, 4.0, 2.0, 65.0, -40.0, 90.0]),
        ] {
            if structure.contains(letter) {
                writeln!(assembly, "{letter} = {six:?}").expect("a String");
            }
        }
        let kept = format!("{}{assembly}", geometry(structure));
        let truth = format!("{kept}[errors]\n{TILTS}");
        let (truth, found) = round_trip(folder.path(), &truth, &kept, &straight_lines(), "");
        let left = compare(&truth, &found.machine, 300, 2);
        assert!(left.position_um < 0.02, "{structure}: {left:?}");
    }
}

/// Machine text with every error motion of the linear axes, with constants and slopes, and every location error; and the names of these errors.
pub(crate) fn every_error(structure: &str) -> (String, Vec<String>) {
    let mut errors = String::new();
    for (axis, (letter, length)) in
        [("X", 600.0), ("Y", 500.0), ("Z", 400.0_f64)].into_iter().enumerate()
    {
        for (component, what) in COMPONENTS.into_iter().enumerate() {
            let wave = |k: f64| ((7 * axis + 5 * component + 3) as f64 * k).sin();
            let c =
                [6.0 * wave(1.3), 20.0 * wave(2.1) / length, -25.0 * wave(0.7) / length.powi(2)];
            writeln!(errors, "{what}{letter} = {{ poly = {c:?} }}").expect("a String");
        }
    }
    let mut unknown = Vec::new();
    for (letter, names) in [
        ('A', ["EY0A", "EZ0A", "EB0A", "EC0A"]),
        ('B', ["EX0B", "EZ0B", "EA0B", "EC0B"]),
        ('C', ["EX0C", "EY0C", "EA0C", "EB0C"]),
    ] {
        for (place, name) in names.into_iter().enumerate() {
            if structure.contains(letter) {
                let value = 20.0 * (f64::from(letter as u32) + 2.3 * place as f64).sin();
                writeln!(errors, "{name} = {value:?}").expect("a String");
                unknown.push(name.to_owned());
            }
        }
    }
    let truth = format!("{}[errors]\n{TILTS}{errors}", geometry(structure));
    (truth, unknown)
}

/// Shop text that measures every line of the linear axes with the other axes held; `more` precedes all tables.
pub(crate) fn every_line(held: &str, more: &str) -> String {
    let held = |linear: &str| match held {
        "" => format!("at = {{ {linear} }}"),
        _ => format!("at = {{ {linear}, {held} }}"),
    };
    let at =
        [held("Y = 200.0, Z = 100.0"), held("X = 300.0, Z = 150.0"), held("X = 250.0, Y = 150.0")];
    let mut lines = format!(
        "machine = \"truth.toml\"\nformat = \"csv\"\n{more}[instrument]\nruns = 1\ntargets = 7\nboth_directions = false\nalignment_urad = 40.0\n"
    );
    for (axis, letter) in ["X", "Y", "Z"].into_iter().enumerate() {
        let names = |tilts: bool| {
            let part = &COMPONENTS[if tilts { 3..6 } else { 0..3 }];
            let names = part.iter().map(|what| format!("\"{what}{letter}\""));
            names.collect::<Vec<_>>().join(", ")
        };
        for tilts in [true, false] {
            writeln!(
                lines,
                "[[measurement]]\nerrors = [{}]\n{}\ncurve = {{ poly = {{ order = 2 }} }}",
                names(tilts),
                at[axis]
            )
            .expect("a String");
        }
    }
    lines + SQUARES
}

/// Lines measured with rotary axes off zero, and spheres for the rotary axes, in one file: the calibrated machine agrees within 0.02 µm.
#[test]
fn lines_with_rotary_axes_off_zero_make_the_machine() {
    for (structure, held) in [
        ("w X' b Y Z C B t", "C = 30.0, B = 20.0"),
        ("w C' B' X' Y' b Z t", "C = -40.0, B = 30.0"),
        ("w Y' A' b X C Z t", "C = 30.0, A = 35.0"),
        ("w X' C' b B Y Z t", "C = 30.0, B = 15.0"),
        ("w C' A' Z' b X Y t", "C = 70.0, A = -30.0"),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        let (truth, unknown) = every_error(structure);
        let shop = every_line(held, &format!("unknown = {unknown:?}\n"))
            + "[[observation]]\nkind = \"sphere\"\nreads = \"offset\"\ncentres = [[200.0, 150.0, 100.0], [400.0, 300.0, 200.0]]\nposes = 12\n";
        let (truth, found) = round_trip(folder.path(), &truth, "", &shop, "");
        let left = compare(&truth, &found.machine, 1000, 3);
        assert!(left.position_um < 0.02, "{structure}: {left:?}");
    }
}
