//! Text files of tables: numbers in them, and where something in them is wrong.

use volcomp_document::InputError;
use volcomp_model::ModelError;
use volcomp_vocabulary::Displacement;

use super::format::Format;
use crate::TablesError;

/// A text file: its name and what it holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextFile {
    /// The name, without folders where it is to be written.
    pub name: String,
    /// The content.
    pub text: String,
}

impl TextFile {
    /// The name behind the last slash.
    pub(crate) fn base(&self) -> &str {
        self.name.rsplit(['/', '\\']).next().unwrap_or(&self.name)
    }

    /// A line, counted from 1.
    pub(crate) fn at(&self, line: usize) -> FilePosition<'_> {
        FilePosition {
            file: self,
            line: Some(line),
        }
    }

    pub(crate) fn whole(&self) -> FilePosition<'_> {
        FilePosition {
            file: self,
            line: None,
        }
    }
}

/// The line of a file, or the whole file, that an error or a warning is about.
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

    /// More lines of values than a control takes.
    pub(crate) fn too_many(self, most: usize) -> ExchangeError {
        self.error(
            format!("a line {}", most + 1),
            format!("{most} at the most"),
        )
    }

    pub(crate) fn warning(self, text: impl Into<String>) -> Warning {
        Warning {
            file: self.file.name.clone(),
            line: self.line,
            text: text.into(),
        }
    }
}

/// Something odd in a file that was read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {text}", line.map_or_else(String::new, |line| format!(":{line}")))]
pub struct Warning {
    /// The file.
    pub file: String,
    /// The line, from 1; `None` where the whole file is meant.
    pub line: Option<usize>,
    /// What is odd, and what was made of it.
    pub text: String,
}

/// Larger numbers are no positions or deviations of a machine.
const LARGEST: f64 = 1e9;

/// A number in a file: finite, and none that no machine has. `-0.000` is 0.
pub(crate) fn number(text: &str) -> Option<f64> {
    let number: f64 = text.trim().parse().ok()?;
    let sane = text.bytes().any(|byte| byte.is_ascii_digit()) && number.abs() <= LARGEST;
    sane.then_some(number + 0.0)
}

/// A number with so many decimals, never `-0`.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|byte| matches!(byte, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

/// A number with at most so many decimals, without zeros at its end.
pub(crate) fn short(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if !text.contains('.') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// A number with its sign and so many decimals.
pub(crate) fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if text.starts_with('-') {
        text
    } else {
        format!("+{text}")
    }
}

/// The nearest whole number; `None` where it is beyond those that files hold.
pub(crate) fn whole(value: f64) -> Option<i64> {
    let rounded = value.round();
    #[expect(clippy::cast_possible_truncation, reason = "checked beside it")]
    (rounded.abs() <= 1e15).then_some(rounded as i64)
}

/// A line of a file that is wrong.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: found {found}, expected {expected}", line.map_or_else(String::new, |line| format!(":{line}")))]
pub struct LineError {
    /// The file as it was named.
    pub file: String,
    /// The line, from 1; `None` where the whole file is meant.
    pub line: Option<usize>,
    /// What the line holds at the place that is wrong.
    pub found: String,
    /// What was expected.
    pub expected: String,
}

/// Why tables cannot be made, written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExchangeError {
    /// The model cannot answer.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A line of a file is wrong.
    #[error(transparent)]
    Line(#[from] LineError),
    /// A cell of a CSV file is wrong.
    #[error(transparent)]
    Cell(#[from] Box<InputError>),
    /// A wish that cannot be.
    #[error("{what}: found {found}, expected {expected}")]
    Wish {
        /// The option, with the axis where there is one.
        what: String,
        /// What was wished for.
        found: String,
        /// What can be.
        expected: String,
    },
    /// A correction or an error beyond the limit of the options.
    #[error("{what} is {found:.1}, expected at most {limit}: check the units in the machine file")]
    BeyondLimit {
        /// Which table, and where in it.
        what: String,
        /// The value.
        found: Displacement,
        /// The limit.
        limit: Displacement,
    },
    /// A value in a file, or in tables that are to be written, that no machine tool has.
    #[error("{}{what} is {found:.1}, expected at most {most}", if files.is_empty() { String::new() } else { format!("{}: ", files.join(", ")) })]
    Implausible {
        /// The files that were read; none where tables are to be written.
        files: Vec<String>,
        /// Which table, and where in it.
        what: String,
        /// The value.
        found: Displacement,
        /// The largest plausible value.
        most: Displacement,
    },
    /// The format cannot hold what there is.
    #[error("{format}: {what}: found {found}, expected {expected}")]
    Unfit {
        /// The format.
        format: Format,
        /// Which table or number.
        what: String,
        /// What there is.
        found: String,
        /// What the format holds.
        expected: String,
    },
    /// Tables that make no curves of a machine file.
    #[error("{0}")]
    NoCurves(String),
}

impl ExchangeError {
    pub(crate) fn unfit(
        format: Format,
        what: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Unfit {
            format,
            what: what.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    /// An option with a value that it cannot have.
    pub(crate) fn option(
        what: impl Into<String>,
        found: &impl ToString,
        expected: impl Into<String>,
    ) -> Self {
        Self::Wish {
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
