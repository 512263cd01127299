#![doc = include_str!("../README.md")]

mod csv_file;
mod error;
mod toml_file;

pub use csv_file::{Cell, Column, CsvRow, CsvTable};
pub use error::InputError;
pub use toml_file::{Document, Section, Value};
