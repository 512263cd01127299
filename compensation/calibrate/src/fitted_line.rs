//! The mean readings of one line as its curve follows them: what a plot shows beside the curve.

use volcomp_model::Source;
use volcomp_vocabulary::ErrorName;

use crate::{calibration_file::CalibrationFile, profile::Profile};

/// One measured line of an error, brought to where its curve is.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedLine {
    /// The error that the curve states.
    pub error: ErrorName,
    /// The place of the line in [`CalibrationFile::measurements`]; `None` where the error was found from several other
    /// lines.
    pub line: Option<usize>,
    /// The files that its readings come from.
    pub sources: Vec<Source>,
    /// Targets (mm or deg, ascending) and mean readings (µm or µrad), forward and backward: without what tilts and other
    /// axes add, a straightness without its line, moved onto the first line of its error, with the zero of the curve.
    /// Empty in a direction that was not run.
    pub points: [Vec<(f64, f64)>; 2],
    /// How many times a difference of readings counts in the error: 1, or along an oblique axis the share of a component.
    pub factor: f64,
}

impl FittedLine {
    /// The line of a profile, with the factor and the zero of its curve.
    pub(crate) fn new(
        file: &CalibrationFile,
        error: ErrorName,
        profile: &Profile<'_>,
        (factor, zero): (f64, f64),
    ) -> Self {
        let mut lines = file.measurements.iter();
        Self {
            error,
            line: lines.position(|line| std::ptr::eq(line, profile.line)),
            sources: profile.line.sources.clone(),
            factor,
            points: profile.points.each_ref().map(|points| {
                let points = points.iter();
                points
                    .map(|(target, value)| (*target, (value - zero) * factor))
                    .collect()
            }),
        }
    }
}
