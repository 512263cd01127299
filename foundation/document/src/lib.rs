#![doc = include_str!("../README.md")]

mod error;
mod toml_file;

pub use error::InputError;
pub use toml_file::{Document, Section, Value};
