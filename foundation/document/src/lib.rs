#![doc = include_str!("../README.md")]

mod csv_file;
mod error;
mod lookup;
mod read;
mod toml_file;

pub use csv_file::{Cell, Column, CsvRow, CsvTable};
pub use error::InputError;
pub use read::ReadError;
pub use toml_file::{Document, Section, Value};
