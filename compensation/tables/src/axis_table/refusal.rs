//! Why tables cannot be written, or files not be read.

use volcomp_document::InputError;
use volcomp_model::ModelError;
use volcomp_vocabulary::Displacement;

use super::{format::Format, text::TextFile};
use crate::TablesError;

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

impl LineError {
    pub(crate) fn at(
        file: &TextFile,
        line: usize,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> ExchangeError {
        ExchangeError::Line(Self {
            file: file.name.clone(),
            line: Some(line),
            found: found.into(),
            expected: expected.into(),
        })
    }

    /// A line of values beyond the most that the control takes.
    pub(crate) fn too_many(file: &TextFile, line: usize, most: usize) -> ExchangeError {
        let (found, expected) = (
            format!("a line {}", most + 1),
            format!("{most} at the most"),
        );
        Self::at(file, line, found, expected)
    }

    pub(crate) fn whole(
        file: &TextFile,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> ExchangeError {
        ExchangeError::Line(Self {
            file: file.name.clone(),
            line: None,
            found: found.into(),
            expected: expected.into(),
        })
    }
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
