#![doc = include_str!("../README.md")]

mod answers;
mod branches;
mod calibration;
mod calibration_file;
mod checks;
mod curve_choice;
mod draft;
mod ensemble;
mod error;
mod identified;
mod line_contribution;
mod line_of_sight;
mod profile;
mod proposal;
mod read;
mod stages;
#[cfg(feature = "serde")]
mod summary;
mod tables;
#[cfg(test)]
mod testing;
mod varied;

pub use answers::{Answer, AnswerError, KEEP_DEFAULT, LEAVE_OUT, LEVER_KEYS, Subject, Turn};
pub use branches::{
    FitQuality, FittedCurve, FittedLine, Quality, ReadingsFit, fit_readings, noise_of_mean,
};
pub use calibration::{
    Calibration, calibrate, calibrated_machine, errors_without_value, not_observed, not_stated,
};
pub use calibration_file::{
    CalibrationFile, Diagonals, Line, Location, Method, Setup, Squareness, SquarenessSource,
    Uncertainty, decode_motion, is_square,
};
pub use checks::{different_machines, with_files};
pub use curve_choice::CurveChoice;
pub use draft::{Draft, LeftOver, draft, draft_of, files_below};
pub use ensemble::{Ensemble, Scatter};
pub use error::CalibrateError;
pub use identified::Identified;
pub use line_of_sight::{ArtefactPoses, LineOfSight, location_seen};
pub use profile::mean_scatter;
pub use proposal::{OPEN, Proposed, Question};
pub use read::{HOLDS_LOCATION, decode_holds_location};
pub use stages::squareness_lines_of_one_run;
#[cfg(feature = "serde")]
pub use summary::{CalibrationSummary, FittedRow, Residual, Stated};
pub use tables::decode_location_errors;
pub use varied::LineScatter;
