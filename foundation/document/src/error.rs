use core::ops::Range;

/// Error at a location in a TOML or CSV file.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{file}:{line}: {key}{}{message}", if key.is_empty() { "" } else { ": " })]
pub struct InputError {
    /// Name of the file, as given by the caller.
    pub file: String,
    /// Line in the file, from 1.
    pub line: usize,
    /// Key with the names of its tables (`errors.EXX.table`), or column of a CSV file. Empty if the error is about the
    /// whole file or row.
    pub key: String,
    /// One sentence that states what was found and what was expected.
    pub message: String,
    /// Byte range of the wrong text, for programs that show it.
    pub span: Range<usize>,
    /// Text of the file, for programs that show the location.
    pub text: std::sync::Arc<str>,
}
