//! What is wrong in a file, and where.

use core::ops::Range;

/// A place in a TOML file and what is wrong there.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}:{line}: {key}{}{message}", if key.is_empty() { "" } else { ": " })]
pub struct InputError {
    /// The file.
    pub file: String,
    /// Line, from 1.
    pub line: usize,
    /// The key, with the tables before it: `errors.EXX.table`; empty for the whole file.
    pub key: String,
    /// What was found and what was expected.
    pub message: String,
    /// Place in the file, bytes.
    pub span: Range<usize>,
    /// The text of the file, for programs that show the place.
    pub text: std::sync::Arc<str>,
}
