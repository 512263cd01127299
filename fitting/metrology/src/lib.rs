//! Measurement files and ISO 230 evaluation: positioning, straightness, squareness, Abbe.

mod csv_file;
mod encoding;
mod error;
mod measurement;
mod number;
mod read;
mod renishaw;

pub use csv_file::{parse_csv, write_csv};
pub use error::{Finding, MetrologyError};
pub use measurement::{
    DeviationUnit, Direction, Environment, Measurement, Metadata, Reading, StartEnd,
};
pub use read::{READ_EXTENSIONS, read_file};
pub use renishaw::{RenishawKind, parse_renishaw, write_renishaw};
