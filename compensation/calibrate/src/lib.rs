#![doc = include_str!("../README.md")]

mod abbe;
mod angular;
mod answers;
mod branches;
mod calibration;
mod calibration_file;
mod checks;
mod contradictions;
mod curve_choice;
mod diagonals;
mod draft;
mod draft_text;
mod error;
mod few_runs;
mod fitted;
mod fitted_curve;
mod fitted_line;
mod hints;
mod identified;
mod line_of_sight;
mod linear;
mod lines_share;
mod location_file;
mod locations;
mod not_measured;
mod observed;
mod other_values;
mod others;
mod parallel_lines;
mod profile;
mod questions;
mod read;
mod same_readings;
mod set_up;
mod setup;
mod setup_file;
mod side_by_side;
mod slopes;
mod squareness_file;
mod squares;
mod stages;
#[cfg(test)]
mod testing;
mod varied;

pub use answers::{Answer, AnswerError, Subject};
pub use calibration::{Calibration, calibrate, calibrated_machine};
pub use calibration_file::{
    CalibrationFile, Line, Location, Squareness, SquarenessSource, Uncertainty,
};
pub use curve_choice::CurveChoice;
pub use diagonals::Diagonals;
pub use draft::{Draft, LeftOver, Proposed, Question, draft};
pub use error::CalibrateError;
pub use fitted_curve::{FitQuality, FittedCurve, Quality};
pub use fitted_line::FittedLine;
pub use identified::Identified;
pub use line_of_sight::LineOfSight;
pub use location_file::{decode_location_errors, is_square};
pub use not_measured::not_observed;
pub use questions::OPEN;
pub use read::{HOLDS_LOCATION, decode_holds_location};
pub use set_up::{SetUp, location_seen};
pub use setup::{Method, Setup};
pub use setup_file::decode_motion;
pub use varied::LineScatter;
