use core::ops::Range;

/// Error at a location of a TOML or CSV file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}:{line}: {key}{}{message}", if key.is_empty() { "" } else { ": " })]
pub struct InputError {
    /// File as named by the caller.
    pub file: String,
    /// Line in the file, from 1.
    pub line: usize,
    /// Key with the tables before it (`errors.EXX.table`), or the column of a CSV file; empty if the whole file or row is concerned.
    pub key: String,
    /// One sentence with the text found and what was expected.
    pub message: String,
    /// Byte range of the wrong text, for programs that display it.
    pub span: Range<usize>,
    /// Text of the file, for programs that display the location.
    pub text: std::sync::Arc<str>,
}
