//! A rotary axis measured over a turn that differs from its travel: the error is correct at every angle.

use std::fmt::Write as _;

use volcomp_calibrate::CalibrateError;
use volcomp_kinematics::Form;
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::AxisName;

use crate::lab::Lab;

/// The machine from a calibration of ECC = 20·sin C µrad.
fn calibrated(travel: &str, targets: impl Iterator<Item = i32>, curve: &str) -> Machine {
    tried(travel, targets, curve).expect("calibrated")
}

fn tried(
    travel: &str,
    targets: impl Iterator<Item = i32>,
    curve: &str,
) -> Result<Machine, CalibrateError> {
    let machine = format!(
        "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 500]\nZ.travel = [0, 500]\n\
         C = {{ travel = {travel}, modulo = 360 }}\n"
    );
    let lab = Lab::new(&machine);
    let mut readings = "target,deviation\n".to_owned();
    for target in targets {
        let deviation = 20.0 * f64::from(target).to_radians().sin();
        writeln!(readings, "{target},{deviation}").expect("a text");
    }
    lab.write("c.csv", &readings);
    let text = format!(
        "[[measurement]]\nerror = \"ECC\"\nfile = \"c.csv\"\nunit = \"urad\"\ncurve = {curve}\n"
    );
    Ok(lab.tried(&text)?.machine)
}

/// Largest difference of ECC from 20·sin C over two turns, µrad; fails if a curve is outside its range.
fn largest_difference(machine: &Machine) -> f64 {
    let mut largest = 0.0_f64;
    for step in -144..=144 {
        let degrees = f64::from(step) * 2.5;
        let state = machine.state(&[(AxisName::C, degrees)]).expect("a state");
        assert_eq!(machine.outside_range(&state), [], "C {degrees}");
        let found = machine.error_at(&state, Form::Exact, &Temperatures::new());
        let expected = 20.0 * degrees.to_radians().sin();
        largest = largest.max((found.rotation_rad.z * 1e6 - expected).abs());
    }
    largest
}

#[test]
fn no_half_turn_is_lost() {
    for (travel, first, last) in [("[0, 360]", -180, 180), ("[-180, 180]", 0, 360)] {
        for (curve, within) in [
            ("{ fourier = { order = 1 } }", 1e-6),
            ("{ mls = { order = 4, support = 0.34 } }", 0.1),
            ("{ table = { interpolation = \"linear\" } }", 0.2),
            ("{ table = { interpolation = \"cubic\" } }", 0.4),
            ("{ bspline = {} }", 0.2),
            ("{ poly = { order = 9 } }", 0.1),
            ("\"auto\"", 0.2),
        ] {
            let found = largest_difference(&calibrated(travel, (first..=last).step_by(15), curve));
            assert!(found < within, "{travel}, {curve}: {found} µrad off");
        }
    }
}

/// A full turn is closed without a repeated target: the curve is within 0.2 µrad of the truth.
#[test]
fn a_full_turn_is_closed() {
    for (travel, first, last) in [("[0, 360]", 0, 345), ("[-180, 180]", -165, 180)] {
        let targets = (first..=last).step_by(15);
        for curve in ["{ fourier = { order = 1 } }", "{ table = {} }"] {
            let found = largest_difference(&calibrated(travel, targets.clone(), curve));
            assert!(found < 0.2, "{travel}, {curve}: {found} µrad off");
        }
    }
}

/// A curve over part of a turn is not closed: the end values are held, and the machine rejects a jump between them.
#[test]
fn a_part_of_a_turn_stays_one() {
    // 20·sin has the same value at 60° and 120°.
    let machine = calibrated("[0, 360]", (60..=120).step_by(5), "{ fourier = { order = 2 } }");
    let turned = |degrees: f64| {
        let state = machine.state(&[(AxisName::C, degrees)]).expect("a state");
        let found = machine.error_at(&state, Form::Exact, &Temperatures::new());
        (found.rotation_rad.z * 1e6, machine.outside_range(&state).len())
    };
    let ((held, outside), (end, inside)) = (turned(270.0), turned(120.0));
    assert_eq!((outside, inside), (1, 0));
    assert!((held - end).abs() < 1e-6, "{held} µrad, expected {end}");
    let refused =
        tried("[0, 360]", (0..=40).step_by(5), "\"auto\"").expect_err("a jump of 12.9 µrad");
    assert!(refused.to_string().contains("where the axis rolls over"), "{refused}");
}

/// Lines of motions in a rotating frame are rejected: an instrument that does not rotate measures a mixture of two motions.
#[test]
fn lines_of_motions_that_turn_with_the_axis_are_refused() {
    for (frame, error, is_read) in [
        ("turning", "EXC", false),
        ("turning", "EBC", false),
        ("turning", "EZC", true),
        ("turning", "ECC", true),
        ("fixed", "EXC", true),
    ] {
        let lab = Lab::new(&format!(
            "structure = \"w C' b X t\"\n[axes]\nX.travel = [0, 500]\nC = {{ travel = [0, 360], motion_frame = \"{frame}\" }}\n"
        ));
        lab.write("c.csv", "target,deviation\n0,0\n90,1\n180,2\n270,1\n");
        let unit = if error.starts_with("EB") || error.starts_with("EC") { "urad" } else { "um" };
        let text =
            format!("[[measurement]]\nerror = \"{error}\"\nfile = \"c.csv\"\nunit = \"{unit}\"\n");
        let read = lab.read(&text);
        assert_eq!(read.is_ok(), is_read, "{frame} {error}: {:?}", read.err());
        if let Err(error) = read {
            let error = error.to_string();
            assert!(error.contains(":3: measurement[0].error"), "{error}");
            assert!(error.contains("does not turn"), "{error}");
        }
    }
}
