//! Parallel lines on the published gantry, whose positioning of Y depends on the height through the pitch of its beam.

use std::fmt::Write as _;

use volcomp_calibrate::Calibration;
use volcomp_kinematics::Form;
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName;

use crate::lab::{Lab, Line, Noise, measure};

const TRAVEL: [[f64; 2]; 3] = [[0.0, 8000.0], [0.0, 4000.0], [0.0, 2500.0]];

/// The gantry with a length error of Y and a pitch error of Y: EYY is 42 µm at Z = 1050 and 68 µm at Z = 650 over 4 m,
/// an almost linear pitch of 65 µrad.
fn gantry(errors: &str) -> Machine {
    let axes = volcomp_test_support::machines::gantry(TRAVEL);
    Machine::parse(&format!("{axes}[errors]\n{errors}"), "truth").expect("a machine")
}

const PITCH: &str = "EAY = { poly = [0, 0.0158, 1.125e-7] }\n";
const LENGTH: &str = "EYY = { poly = [0, 0.0275625] }\n";

/// Writes a line along Y with the reflector away from the point of the beam, and returns its table for the calibration
/// file.
fn line(lab: &Lab, truth: &Machine, error: &str, [x, z]: [f64; 2], sigma: f64) -> String {
    let line = Line {
        error,
        at: &[(AxisName::X, 4000.0), (AxisName::Z, z)],
        point: [x, 0.0, z],
        other: false,
        targets: 21,
        runs: 5,
    };
    let mut noise = Noise::new(z.to_bits());
    let file = format!("{error}-{x}-{z}.csv");
    measure(lab, truth, &file, &line, sigma, &mut noise) + "curve = { poly = { order = 2 } }\n"
}

fn lab() -> Lab {
    Lab::new(&volcomp_test_support::machines::gantry(TRAVEL))
}

/// Positioning deviation of Y from 0 to 4000 mm at this height, µm.
fn positioning_um(machine: &Machine, z: f64) -> f64 {
    let none = Temperatures::new();
    let at = |y| {
        let state = machine.state(&[(AxisName::X, 4000.0), (AxisName::Y, y), (AxisName::Z, z)]);
        let error = machine.error_at(&state.expect("a state"), Form::Exact, &none);
        error.position_mm.y * 1e3
    };
    at(4000.0) - at(0.0)
}

fn has(found: &Calibration, parts: &[&str]) -> bool {
    let is = |warning: &String| parts.iter().all(|part| warning.contains(part));
    found.warnings.iter().any(is)
}

#[test]
fn two_heights_give_the_pitch_and_the_published_figures_over_heights() {
    let lab = lab();
    let truth = gantry(&format!("{LENGTH}{PITCH}"));
    assert!((positioning_um(&truth, 1050.0) - 42.0).abs() < 0.1);
    assert!((positioning_um(&truth, 650.0) - 68.0).abs() < 0.1);
    let lines = [1050.0, 650.0].map(|z| line(&lab, &truth, "EYY", [0.0, z], 0.3));
    let found = lab.calibrated(&lines.concat());
    // The published values are 23 to 70 µm between these heights.
    for (z, expected) in [(1342.3, 23.0), (1050.0, 42.0), (650.0, 68.0), (619.2, 70.0)] {
        let value = positioning_um(&found.machine, z);
        assert!((value - expected).abs() < 1.0, "{value} µm at Z = {z}, expected {expected}");
    }
    let words =
        ["EAY was not measured: it was found from the lines of EYY", "standard uncertainty"];
    assert!(has(&found, &words), "{:?}", found.warnings);
    assert!(
        !has(&found, &["contradict"]) && !has(&found, &["keeps its part"]),
        "{:?}",
        found.warnings
    );
}

#[test]
fn a_pitch_that_is_twice_too_large_contradicts_the_lines() {
    let lab = lab();
    let truth = gantry(&format!("{LENGTH}{PITCH}"));
    let mut lines: Vec<String> =
        [1050.0, 650.0].map(|z| line(&lab, &truth, "EYY", [0.0, z], 0.3)).into();
    lines.push(line(&lab, &truth, "EAY", [0.0, 0.0], 0.3));
    let good = lab.calibrated(&lines.concat());
    assert!(!has(&good, &["contradict"]), "{:?}", good.warnings);
    let doubled = gantry("EAY = { poly = [0, 0.0316, 2.25e-7] }\n");
    lines[2] = line(&lab, &doubled, "EAY", [0.0, 0.0], 0.3);
    let bad = lab.calibrated(&lines.concat());
    // 65 µrad over 400 mm are 26 µm, of which half is above and half below the mean; slightly more at the end of the
    // curve.
    let words = [
        "EYY: ",
        "EYY-0-1050.csv and ",
        "EYY-0-650.csv contradict each other by up to ±",
        "times their noise of 0.",
        "check the files, and their `point`, `at`, `unit` and `sign`",
    ];
    assert!(has(&bad, &words), "{:?}", bad.warnings);
    let note = bad.warnings.iter().find(|w| w.contains("contradict")).expect("a note");
    let size = note.split('±').nth(1).and_then(|rest| rest.split(' ').next());
    let size: f64 = size.expect("a size").parse().expect("a number");
    assert!((size - 13.1).abs() < 0.8, "{note}");
    // Two contradictory files of one tilt give a note as well.
    lines[2] = line(&lab, &truth, "EAY", [0.0, 0.0], 0.3);
    lines.push(line(&lab, &doubled, "EAY", [0.0, 500.0], 0.3));
    let words = [
        "EAY: ",
        "EAY-0-0.csv and ",
        "EAY-0-500.csv contradict each other by up to ±",
        "check the files",
    ];
    let bad = lab.calibrated(&lines.concat());
    assert!(has(&bad, &words), "{:?}", bad.warnings);
}

#[test]
fn lines_that_do_not_separate_the_tilts_are_noted() {
    let lab = lab();
    let truth = gantry(&format!("{LENGTH}{PITCH}ECY = {{ poly = [0, 0.01] }}\n"));
    let measured = |places: &[[f64; 2]]| {
        let lines = places.iter().map(|place| line(&lab, &truth, "EYY", *place, 0.3));
        lab.calibrated(&lines.collect::<String>())
    };
    let two = measured(&[[0.0, 1050.0], [900.0, 650.0]]);
    let words = ["EAY and ECY were not measured, and the 2 lines of EYY", "determine 1 of 2 tilts"];
    assert!(has(&two, &words), "{:?}", two.warnings);
    let near = measured(&[[0.0, 1050.0], [0.0, 1020.0]]);
    assert!(has(&near, &["EAY was not measured", "differ by too little"]), "{:?}", near.warnings);
    let three = measured(&[[0.0, 1050.0], [900.0, 650.0], [0.0, 650.0]]);
    for error in ["EAY", "ECY"] {
        let name = error.parse().expect("a name");
        let index = truth.index_of(AxisName::Y).expect("an axis");
        let mut at = [0.0; 9];
        at[index] = 4000.0;
        let [found, expected] = [&three.machine, &truth]
            .map(|machine| machine.error(name).expect("a curve").value(index, &at, None));
        assert!((found - expected).abs() < 3.0, "{error}: {found} {expected}");
        let text = format!("{error} was not measured: it was found");
        assert!(has(&three, &[&text]), "{:?}", three.warnings);
    }
}

/// Calibration from two lines 600 mm apart with little noise, and from one run of the pitch with much noise.
fn with_noisy_pitch(lab: &Lab, pitch: &Machine, truth: &Machine, seed: u64) -> Calibration {
    let mut noise = Noise::new(seed);
    let mut tables = String::new();
    for (name, error, z, runs, sigma) in [
        ("low", "EYY", 450.0, 5, 0.1),
        ("high", "EYY", 1050.0, 5, 0.1),
        ("pitch", "EAY", 0.0, 1, 2.0),
    ] {
        let line = Line {
            error,
            at: &[(AxisName::X, 4000.0), (AxisName::Z, z)],
            point: [0.0, 0.0, z],
            other: false,
            targets: 21,
            runs,
        };
        let machine = if error == "EAY" { pitch } else { truth };
        let file = format!("{name}.csv");
        tables += &measure(lab, machine, &file, &line, sigma, &mut noise);
        tables += "curve = { table = {} }\n";
    }
    lab.calibrated(&tables)
}

/// Lines with slopes of 0 and 40 µm/m contradict each other, also with both directions or other targets.
#[test]
fn lines_of_different_slopes_contradict_each_other() {
    let lab = lab();
    for (name, runs, other_targets) in [("one run", 1, 11), ("five runs", 5, 7), ("uneven", 1, 8)] {
        let lines = [(0.0, 11, 100.0), (0.04, other_targets, 200.0)].map(|(slope, targets, z)| {
            let mut noise = Noise::new(7);
            let mut text = "target mm,run,direction,deviation um\n".to_owned();
            for run in 1..=runs {
                for direction in ["+", "-"] {
                    for place in 0..targets {
                        let share = f64::from(place) / f64::from(targets - 1);
                        let at = 1000.0 * if name == "uneven" { share * share } else { share };
                        // Each run has its own zero, which does not count as scatter of the slope.
                        let value = 10.0 * f64::from(run) + slope * at + noise.normal(0.1);
                        let _ = writeln!(text, "{at},{run},{direction},{value}");
                    }
                }
            }
            let file = format!("{targets}-{z}.csv");
            lab.write(&file, &text);
            format!("[[measurement]]\nerror = \"EXX\"\nfile = \"{file}\"\nat = {{ Y = 0.0, Z = {z:?} }}\ncurve = {{ poly = {{ order = 1 }} }}\n")
        });
        let found = lab.calibrated(&lines.concat());
        assert!(has(&found, &["EXX", "contradict"]), "{name}: {:?}", found.warnings);
        assert!(!found.machine.provenance().undecided.is_empty(), "{name}");
    }
}

/// Lines do not contradict each other if their slopes differ by no more than the slopes of single runs scatter. The
/// runs scatter because the beam is realigned.
#[test]
fn slopes_within_the_scatter_of_runs_do_not_contradict() {
    let lab = lab();
    for (second, contradicts) in [([0.0, 20.0, 40.0], false), ([100.0, 120.0, 140.0], true)] {
        let lines = [([-20.0, 0.0, 20.0], 100.0), (second, 200.0)].map(|(slopes, z)| {
            let mut noise = Noise::new(3);
            let mut text = "target mm,run,direction,deviation um\n".to_owned();
            for (run, slope) in (1..).zip(slopes) {
                for place in 0..11 {
                    let at = 100.0 * f64::from(place);
                    let value = 1e-3 * slope * at + noise.normal(0.1);
                    let _ = writeln!(text, "{at},{run},+,{value}");
                }
            }
            let file = format!("exy-{z}.csv");
            lab.write(&file, &text);
            format!("[[measurement]]\nerror = \"EXY\"\nfile = \"{file}\"\nat = {{ X = 0.0, Z = {z:?} }}\ncurve = {{ poly = {{ order = 2 }} }}\n")
        });
        let found = lab.calibrated(&lines.concat());
        let is_noted = has(&found, &["EXY: the slopes of", "contradict"]);
        assert_eq!(is_noted, contradicts, "{second:?}: {:?}", found.warnings);
    }
}

/// The noise of a tilt, times the difference of the levers of two lines, is not reported as a contradiction: 2 µrad
/// over 600 mm are 1.2 µm. A doubled tilt is always reported.
#[test]
fn a_noisy_tilt_is_no_contradiction_and_a_doubled_one_is() {
    let lab = lab();
    let truth = gantry(&format!("{LENGTH}{PITCH}"));
    let doubled = gantry("EAY = { poly = [0, 0.0316, 2.25e-7] }\n");
    let seeds = 1..=30;
    let noted = |pitch: &Machine| {
        let is_noted = |seed: &u64| {
            let found = with_noisy_pitch(&lab, pitch, &truth, *seed);
            has(&found, &["contradict"])
        };
        seeds.clone().filter(is_noted).collect::<Vec<u64>>()
    };
    let (alarms, found) = (noted(&truth), noted(&doubled));
    assert!(alarms.len() <= 1, "false alarms: {alarms:?}");
    assert_eq!(found.len(), seeds.count(), "noted only for {found:?}");
}
