//! Text files of tables: number parsing and formatting, and positions of errors.

use volcomp_document::InputError;
use volcomp_model::ModelError;
use volcomp_vocabulary::Displacement;

use super::format::Format;
use crate::TablesError;

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextFile {
    /// File name; without folders if it is to be written.
    pub name: String,
    pub text: String,
}

impl TextFile {
    /// File name after the last slash or backslash.
    pub(crate) fn base(&self) -> &str {
        self.name.rsplit(['/', '\\']).next().unwrap_or(&self.name)
    }

    /// Position of a line, counted from 1.
    pub(crate) fn at(&self, line: usize) -> FilePosition<'_> {
        FilePosition { file: self, line: Some(line) }
    }

    pub(crate) fn whole(&self) -> FilePosition<'_> {
        FilePosition { file: self, line: None }
    }
}

/// Line of a file, or the whole file, to which an error or a warning refers.
#[derive(Clone, Copy)]
pub(crate) struct FilePosition<'a> {
    pub(crate) file: &'a TextFile,
    pub(crate) line: Option<usize>,
}

impl FilePosition<'_> {
    pub(crate) fn error(
        self,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> ExchangeError {
        ExchangeError::Line(LineError {
            file: self.file.name.clone(),
            line: self.line,
            found: found.into(),
            expected: expected.into(),
        })
    }

    /// Creates the error for a file with more lines of values than the control accepts.
    pub(crate) fn too_many(self, most: usize) -> ExchangeError {
        self.error(format!("a line {}", most + 1), format!("at most {most}"))
    }

    pub(crate) fn warning(self, text: impl Into<String>) -> Warning {
        Warning { file: self.file.name.clone(), line: self.line, text: text.into() }
    }
}

/// An anomaly in a file that was read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {text}", line.map_or_else(String::new, |line| format!(":{line}")))]
pub struct Warning {
    pub file: String,
    /// Line, counted from 1; `None` for the whole file.
    pub line: Option<usize>,
    /// The anomaly and its treatment.
    pub text: String,
}

/// Maximum magnitude of a position or deviation in a file.
const LARGEST: f64 = 1e9;

/// Parses a finite number of plausible magnitude; `-0.000` becomes 0.
pub(crate) fn number(text: &str) -> Option<f64> {
    let number: f64 = text.trim().parse().ok()?;
    let sane = text.bytes().any(|byte| byte.is_ascii_digit()) && number.abs() <= LARGEST;
    sane.then_some(number + 0.0)
}

/// Formats a number with this many decimals, never as `-0`.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|byte| matches!(byte, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

/// Formats a number with at most this many decimals, without trailing zeros.
pub(crate) fn short(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if !text.contains('.') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

pub(crate) fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if text.starts_with('-') { text } else { format!("+{text}") }
}

/// Rounds to a whole number; `None` if it is out of the range of the files.
pub(crate) fn whole(value: f64) -> Option<i64> {
    let rounded = value.round();
    #[expect(clippy::cast_possible_truncation, reason = "checked beside it")]
    (rounded.abs() <= 1e15).then_some(rounded as i64)
}

/// An invalid line of a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: found {found}, expected {expected}", line.map_or_else(String::new, |line| format!(":{line}")))]
pub struct LineError {
    pub file: String,
    /// Line, counted from 1; `None` for the whole file.
    pub line: Option<usize>,
    /// Text in the file that is invalid.
    pub found: String,
    /// Description of valid text.
    pub expected: String,
}

/// Reasons why tables cannot be computed, written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExchangeError {
    /// The model cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A line of a file is invalid.
    #[error(transparent)]
    Line(#[from] LineError),
    /// A cell of a CSV file is invalid.
    #[error(transparent)]
    Cell(#[from] Box<InputError>),
    /// An option has an invalid value.
    #[error("{what}: found {found}, expected {expected}")]
    InvalidOption { what: String, found: String, expected: String },
    #[error("{what} is {found:.1}, expected at most {limit}: check the units in the machine file")]
    BeyondLimit { what: String, found: Displacement, limit: Displacement },
    /// A value in a file, or in tables to be written, is implausible for a machine tool.
    #[error("{}{what} is {found:.1}, expected at most {most}", if files.is_empty() { String::new() } else { format!("{}: ", files.join(", ")) })]
    Implausible {
        /// Names of the files that were read; empty if the tables were to be written.
        files: Vec<String>,
        what: String,
        found: Displacement,
        most: Displacement,
    },
    /// The format cannot represent the data.
    #[error("{format}: {what}: found {found}, expected {expected}")]
    NotRepresentable { format: Format, what: String, found: String, expected: String },
    /// Tables are missing or invalid, or cannot be converted to curves of a machine file.
    #[error("{0}")]
    NoCurves(String),
}

impl ExchangeError {
    pub(crate) fn not_representable(
        format: Format,
        what: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::NotRepresentable {
            format,
            what: what.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub(crate) fn option(
        what: impl Into<String>,
        found: &impl ToString,
        expected: impl Into<String>,
    ) -> Self {
        Self::InvalidOption {
            what: what.into(),
            found: found.to_string(),
            expected: expected.into(),
        }
    }
}

impl From<TablesError> for ExchangeError {
    fn from(error: TablesError) -> Self {
        match error {
            TablesError::Model(error) => Self::Model(error),
            other => Self::NoCurves(other.to_string()),
        }
    }
}

impl From<InputError> for ExchangeError {
    fn from(error: InputError) -> Self {
        Self::Cell(Box::new(error))
    }
}
