//! An error in a file, with its place.

use core::ops::Range;

/// A place in a TOML or CSV file and what is wrong there.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}:{line}: {key}{}{message}", if key.is_empty() { "" } else { ": " })]
pub struct InputError {
    /// The file as the caller named it.
    pub file: String,
    /// The line in the file, from 1.
    pub line: usize,
    /// The key with the tables before it (`errors.EXX.table`), or the column of a CSV file; empty where the whole file
    /// or row is meant.
    pub key: String,
    /// The sentence that says what was found and what was expected.
    pub message: String,
    /// The bytes of the text that are wrong, for programs that show the place.
    pub span: Range<usize>,
    /// The text of the file, for programs that show the place.
    pub text: std::sync::Arc<str>,
}
