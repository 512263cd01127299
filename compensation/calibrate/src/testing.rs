//! Calibration files built in code, for the tests of the stages.

use volcomp_metrology::{Measurement, Reading, ReferenceKind, Rides};
use volcomp_model::Machine;
use volcomp_vocabulary::{AxisName, Direction, ErrorName};

use crate::calibration_file::{CalibrationFile, Line, Method, Setup, Uncertainty};
use crate::curve_choice::CurveChoice;

/// Machine with three axes, in which X carries the table; travels of 1000 mm.
pub(crate) fn machine(errors: &str) -> Machine {
    let text = format!(
        "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0, 1000]\nY.travel = [0, 1000]\nZ.travel = [0, 1000]\n[errors]\n{errors}"
    );
    Machine::parse(&text, "machine.toml").unwrap()
}

pub(crate) fn file(measurements: Vec<Line>) -> CalibrationFile {
    CalibrationFile {
        files: Vec::new(),
        serial: None,
        machine: machine(""),
        reference: vec![0.0; 3],
        reference_axes: [AxisName::X, AxisName::Y],
        measurements,
        squareness: Vec::new(),
        diagonals: Vec::new(),
        locations: Vec::new(),
        observations: None,
        observed: Vec::new(),
        uncertainty: Uncertainty::default(),
    }
}

pub(crate) fn name(error: &str) -> ErrorName {
    error.parse().unwrap()
}

/// One forward run at 0, 100, … 1000, measured at the axis's own point; its curve is a polynomial of order 3.
pub(crate) fn line(error: &str, mut reading: impl FnMut(f64) -> f64) -> Line {
    let readings = (0..=10).map(|step| {
        let target = 100.0 * f64::from(step);
        Reading { target, run: 1, direction: Direction::Positive, deviation: reading(target) }
    });
    Line {
        setup: Setup {
            error: name(error),
            at: vec![0.0; 3],
            point_mcs: None,
            rides: Rides::Carriage,
            method: Method::Direct,
            sign: 1.0,
        },
        file: format!("{error}.csv").into(),
        sources: Vec::new(),
        place: "calibration.toml:1".to_owned(),
        readings: Measurement { readings: readings.collect(), ..Measurement::default() },
        curve: Some(CurveChoice::Polynomial { order: 3 }),
        reference_line: ReferenceKind::LeastSquares,
        holds_location: true,
    }
}
