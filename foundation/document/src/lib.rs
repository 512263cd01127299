#![doc = include_str!("../README.md")]

mod csv_file;
mod error;
pub mod private;
mod read;
mod structure;
mod toml_file;
mod written;

pub use csv_file::{
    Cell, Column, CsvBatches, CsvRow, CsvTable, split_head, split_unit, unit_named,
};
pub use error::{InputError, LARGEST_NUMBER, nearest, quoted};
pub use private::PrivateError;
pub use read::{MAX_TEXT_BYTES, ReadError, read_bytes, read_text, refuse_named_pipe};
pub use structure::{InputErrors, Mistakes, Places};
pub use toml_file::{Document, FileKind, Section, Value};
pub use written::{Note, Severity, csv_cell, toml_key, toml_string};
