#![doc = include_str!("../README.md")]

mod abbe;
mod angular;
mod branches;
mod calibration;
mod calibration_file;
mod checks;
mod curve_choice;
mod error;
mod fitted;
mod fitted_curve;
mod linear;
mod location_file;
mod locations;
mod not_measured;
mod profile;
mod read;
mod setup;
mod setup_file;
mod slopes;
mod squares;
#[cfg(test)]
mod testing;
mod varied;

pub use calibration::{Calibration, calibrate};
pub use calibration_file::{
    CalibrationFile, Line, Location, Squareness, SquarenessSource, Uncertainty,
};
pub use curve_choice::CurveChoice;
pub use error::CalibrateError;
pub use fitted_curve::{FitQuality, FittedCurve, Quality};
pub use setup::{Method, Setup};
pub use setup_file::{decode_error, decode_motion};
