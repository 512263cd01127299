#![doc = include_str!("../README.md")]

mod abbe;
mod csv_file;
mod csv_head;
mod encoding;
mod error;
pub mod form;
mod iso230_2;
mod measurement;
mod motion_kind;
mod number;
mod outliers;
mod read;
mod reading_unit;
mod renishaw;
mod squareness;
mod straightness;

pub use abbe::{CarriedSide, Rides, Travel, abbe_um, lever_mm};
pub use csv_file::{parse_csv, write_csv};
pub use error::{Finding, MetrologyError};
pub use iso230_2::{Approach, Iso230Part2, TargetRow, evaluate};
pub use measurement::{DeviationUnit, Environment, Measurement, Metadata, Reading, StartEnd};
pub use motion_kind::MotionKind;
pub use outliers::{OutlierHint, outlier_hints};
pub use read::{READ_EXTENSIONS, read_file};
pub use reading_unit::ReadingUnit;
pub use renishaw::{RenishawKind, parse_renishaw, write_renishaw};
pub use squareness::{squareness, squareness_parts};
pub use straightness::{ReferenceKind, ReferenceLine, TiltReading, angular_method_um, tilt_sign};
pub use volcomp_vocabulary::Direction;
