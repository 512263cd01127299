//! The reasons why a measurement file, or a request about one, is refused.

use volcomp_document::InputError;

use crate::Direction;

/// Where in a file something is wrong, what stands there and what should.
#[derive(Debug, Clone, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Finding {
    /// The file as it was named by the caller.
    pub file: String,
    /// Line in the file, from 1.
    pub line: usize,
    /// The item concerned: a key, a column, a section.
    pub what: String,
    /// The text found there, shortened when long.
    pub found: String,
    /// The text that the format asks for.
    pub expected: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            file,
            line,
            what,
            found,
            expected,
        } = self;
        write!(
            f,
            "{file}:{line}: {what}: found {found}, expected {expected}"
        )
    }
}

/// Everything that can be wrong with a measurement file or with what is asked of it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages say what most fields are")]
pub enum MetrologyError {
    /// The operating system does not give the file.
    #[error("{file}: cannot be read: {source}")]
    Unreadable {
        file: String,
        source: std::io::Error,
    },
    /// A directory stands where a file should.
    #[error(
        "{file}: found a directory, expected a measurement file ({})",
        crate::READ_EXTENSIONS
    )]
    Directory { file: String },
    /// The extension does not say how to read the file.
    #[error(
        "{file}: found {found}, expected one that is read: {}",
        crate::READ_EXTENSIONS
    )]
    Extension { file: String, found: String },
    /// The file is larger than any measurement file.
    #[error(
        "{file}: found more than {limit_mib} MiB, expected a measurement file of at most that size"
    )]
    TooLarge {
        file: String,
        /// The largest size that is read, MiB.
        limit_mib: u64,
    },
    /// The file holds no data.
    #[error("{file}: found nothing in the file, expected {expected}")]
    Empty { file: String, expected: String },
    /// The bytes are not a text file of a known encoding.
    #[error("{0}")]
    Encoding(Finding),
    /// A table has no header as expected, or a row with more or fewer cells, or points among decimal commas.
    #[error(transparent)]
    Table(Box<InputError>),
    /// The content is of another kind than the extension or the caller says.
    #[error("{0}")]
    Kind(Finding),
    /// A line or key breaks the grammar.
    #[error("{0}")]
    Structure(Finding),
    /// A number is not a number, not finite or out of its range.
    #[error("{0}")]
    Number(Finding),
    /// A declared count differs from what the file holds, a target or key stands twice, or the order of targets contradicts the directions.
    #[error("{0}")]
    Contradiction(Finding),
    /// The file ends before it is complete.
    #[error("{0}")]
    Truncated(Finding),
    /// A target was measured in one direction only, though the other direction was run.
    #[error(
        "{name}: target {target}: found no reading in direction {direction}, expected every target in each direction that was run"
    )]
    TargetLacking {
        name: String,
        /// The target, mm or deg.
        target: f64,
        direction: Direction,
    },
    /// Readings that cannot be evaluated (only possible when built in code).
    #[error("{name}: {what}: found {found}, expected {expected}")]
    Readings {
        name: String,
        what: String,
        found: String,
        expected: String,
    },
    /// The targets are not one bridge length apart.
    #[error(
        "straightness by the angular method, targets {from} and {to}: found a spacing of {found} mm, expected the bridge length {bridge_mm} mm within 1 %"
    )]
    BridgeSpacing {
        /// First target of the pair, mm.
        from: f64,
        /// Second target of the pair, mm.
        to: f64,
        /// The distance between them, mm.
        found: f64,
        /// Foot spacing of the bridge, mm.
        bridge_mm: f64,
    },
    /// A file holds no readings at targets, though something else.
    #[error("{file}: found {found}, expected readings at targets: {how}")]
    NoTargets {
        file: String,
        found: String,
        how: String,
    },
    /// The file that says what the columns or channels of another mean cannot be read.
    #[error("{message}")]
    Mapping { message: String },
    /// A mapping of columns for a log, or of channels for a table.
    #[error("{file}: found {found}, expected {expected}")]
    WrongMapping {
        file: String,
        found: &'static str,
        expected: &'static str,
    },
    /// An error name has no meaning in this place.
    #[error("{what}: found `{found}`, expected {expected}")]
    ErrorName {
        what: String,
        found: String,
        expected: String,
    },
}

impl MetrologyError {
    pub(crate) fn readings(
        name: impl Into<String>,
        what: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Readings {
            name: name.into(),
            what: what.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }
}

impl From<InputError> for MetrologyError {
    fn from(error: InputError) -> Self {
        Self::Table(Box::new(error))
    }
}
