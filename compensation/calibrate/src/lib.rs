#![doc = include_str!("../README.md")]

mod abbe;
mod angular;
mod answers;
mod artefact_poses;
mod branches;
mod calibration;
mod calibration_file;
mod checks;
mod curve_choice;
mod draft;
mod ensemble;
mod error;
mod fitted;
mod identified;
mod line_contribution;
mod line_of_sight;
mod linear;
mod not_measured;
mod observed;
mod profile;
mod proposal;
mod provenance;
mod questions;
mod read;
mod readings_fit;
mod repeated;
mod setup;
mod squareness;
mod squares;
mod stages;
#[cfg(feature = "serde")]
mod summary;
mod tables;
#[cfg(test)]
mod testing;
mod varied;

pub use answers::{Answer, AnswerError, KEEP_DEFAULT, LEAVE_OUT, LEVER_KEYS, Subject, Turn};
pub use artefact_poses::{ArtefactPoses, location_seen};
pub use branches::{FitQuality, FittedCurve, Quality};
pub use calibration::{Calibration, calibrate, calibrated_machine};
pub use calibration_file::{
    CalibrationFile, Diagonals, Line, Location, Squareness, SquarenessSource, Uncertainty,
};
pub use checks::lines::{different_machines, with_files};
pub use curve_choice::CurveChoice;
pub use draft::{Draft, LeftOver, draft, draft_of, files_below};
pub use ensemble::{Ensemble, Scatter};
pub use error::CalibrateError;
pub use fitted::FittedLine;
pub use identified::Identified;
pub use line_of_sight::LineOfSight;
pub use not_measured::{errors_without_value, not_observed, not_stated};
pub use proposal::{Proposed, Question};
pub use questions::OPEN;
pub use read::{HOLDS_LOCATION, decode_holds_location};
pub use readings_fit::{ReadingsFit, fit_readings, noise_of_mean};
pub use repeated::mean_scatter;
pub use setup::{Method, Setup, decode_motion};
pub use squareness::is_square;
pub use squares::squareness_lines_of_one_run;
#[cfg(feature = "serde")]
pub use summary::{CalibrationSummary, FittedRow, Residual, Stated};
pub use tables::decode_location_errors;
pub use varied::LineScatter;
