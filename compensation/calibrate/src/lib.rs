#![doc = include_str!("../README.md")]

mod branches;
mod calibrate;
mod calibration_file;
mod curve_choice;
mod error;
mod instrument;
mod line_of_sight;
mod setup;
mod shop;
mod track;
mod uncertainty;

pub use calibrate::{Calibration, FittedCurve, calibrate};
pub use calibration_file::{CalibrationFile, Line, Squareness, SquarenessSource};
pub use curve_choice::CurveChoice;
pub use error::CalibrateError;
pub use instrument::Instrument;
pub use line_of_sight::LineOfSight;
pub use setup::{Method, Setup};
pub use shop::{Format, Shop, ShopLine};
pub use uncertainty::Uncertainty;
