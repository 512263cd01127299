#![doc = include_str!("../README.md")]

mod bound;
mod csv_file;
mod error;
mod file_kind;
mod head;
mod lookup;
mod nearest;
mod note;
pub mod private;
mod quoted;
mod read;
mod structure;
mod syntax;
mod toml_file;
mod written;

pub use bound::LARGEST_NUMBER;
pub use csv_file::{Cell, Column, CsvBatches, CsvRow, CsvTable};
pub use error::InputError;
pub use file_kind::FileKind;
pub use head::{split_head, split_unit, unit_named};
pub use nearest::nearest;
pub use note::{Note, Severity};
pub use private::PrivateError;
pub use quoted::quoted;
pub use read::{MAX_TEXT_BYTES, ReadError, read_bytes, read_text};
pub use structure::{InputErrors, Mistakes, Places};
pub use toml_file::{Document, Section, Value};
pub use written::{csv_cell, toml_key, toml_string};
