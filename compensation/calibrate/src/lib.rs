#![doc = include_str!("../README.md")]

mod calibrate;
mod calibration_file;
mod error;

pub use calibrate::{Calibration, FittedCurve, calibrate};
pub use calibration_file::{
    CalibrationFile, CurveChoice, Line, Method, Squareness, SquarenessSource,
};
pub use error::CalibrateError;
