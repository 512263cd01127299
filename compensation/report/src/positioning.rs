//! Positioning tests by ISO 230-2.

use volcomp_calibrate::{CalibrationFile, Method};
use volcomp_metrology::{MotionKind, evaluate};

use crate::{curves::runs_of, report::Positioning};

/// Every line of a file that is a positioning test, with its readings as they are.
pub(crate) fn positioning(file: &CalibrationFile) -> Vec<Positioning> {
    let lines = file.measurements.iter();
    let tests = lines.filter(|line| {
        MotionKind::of(line.setup.error) == MotionKind::Positioning
            && line.setup.method == Method::Direct
    });
    let test = |line: &volcomp_calibrate::Line| {
        let error = line.setup.error;
        Some(Positioning {
            file: line.file.display().to_string(),
            error: error.to_string(),
            x_unit: error.axis.kind().coordinate_unit().to_owned(),
            unit: error.component.symbol().to_owned(),
            runs: runs_of(&line.readings, |_, _, reading| Some(reading)),
            // What cannot be evaluated could not be calibrated.
            result: evaluate(&line.readings).ok()?,
        })
    };
    tests.filter_map(test).collect()
}

impl Positioning {
    /// A figure by its symbol: A, R, E, M or B; `None` where the runs do not give it.
    pub fn figure(&self, symbol: &str) -> Option<f64> {
        let r = &self.result;
        match symbol {
            "A" => r.a,
            "R" => r.r,
            "E" => r.e,
            "M" => r.m,
            "B" => r.b,
            _ => None,
        }
    }
}
