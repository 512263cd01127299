use volcomp_document::InputError;

use crate::Direction;

/// Location of an error in a file, with the text found and the text expected.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Finding {
    /// Name of the file, as given by the caller.
    pub file: String,
    /// Line in the file, from 1.
    pub line: usize,
    /// Key, column or section that has the error.
    pub what: String,
    /// Text at this location, shortened if long.
    pub found: String,
    /// Text that the format requires.
    pub expected: String,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { file, line, what, found, expected } = self;
        write!(f, "{file}:{line}: {what}: found {found}, expected {expected}")
    }
}

/// Errors of a measurement file or of a request about one.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MetrologyError {
    #[error("{file}: cannot be read: {source}")]
    Unreadable { file: String, source: std::io::Error },
    #[error("{file}: found a directory, expected a measurement file ({})", crate::READ_EXTENSIONS)]
    Directory { file: String },
    #[error("{file}: found {found}, expected one that is read: {}", crate::READ_EXTENSIONS)]
    Extension { file: String, found: String },
    #[error(
        "{file}: found more than {limit_mib} MiB, expected a measurement file of at most that size"
    )]
    TooLarge { file: String, limit_mib: u64 },
    #[error("{file}: found nothing in the file, expected {expected}")]
    Empty { file: String, expected: String },
    /// The bytes are not text in a known encoding.
    #[error("{0}")]
    Encoding(Finding),
    /// A table has no valid header, a row with too many or too few cells, or decimal points besides decimal commas.
    #[error(transparent)]
    Table(Box<InputError>),
    /// The content is of another kind than the extension or the caller says.
    #[error("{0}")]
    Kind(Finding),
    /// A line or key violates the grammar of the format.
    #[error("{0}")]
    Structure(Finding),
    /// A text is not a number, or a number is not finite or out of its range.
    #[error("{0}")]
    Number(Finding),
    /// A declared count differs from the content, a target or key is repeated, or the order of targets contradicts the
    /// directions.
    #[error("{0}")]
    Contradiction(Finding),
    #[error("{0}")]
    Truncated(Finding),
    #[error(
        "{name}: target {target}: found no reading in direction {direction}, expected every target in each direction that was run"
    )]
    TargetLacking {
        name: String,
        /// Target, mm or deg.
        target: f64,
        direction: Direction,
    },
    /// A run of a straightness measurement has fewer than three targets in common with the other runs, so it cannot be
    /// aligned.
    #[error(
        "{name}: run {runs} {direction}: found fewer than three targets in common with the other runs, expected three: where not all runs hold all targets, the offset and the slope of each run of a straightness come from its common targets; leave the run out or complete it"
    )]
    RunLineUnknown { name: String, runs: String, direction: Direction },
    /// Readings that were built in code and cannot be evaluated.
    #[error("{name}: {what}: found {found}, expected {expected}")]
    Readings { name: String, what: String, found: String, expected: String },
    #[error(
        "straightness by the angular method, targets {from} and {to}: found a spacing of {found} mm, expected the bridge length {bridge_mm} mm within 1 %"
    )]
    BridgeSpacing {
        /// First target of the pair, mm.
        from: f64,
        /// Second target of the pair, mm.
        to: f64,
        /// Distance between the targets of the pair, mm.
        found: f64,
        /// Foot spacing of the bridge, mm.
        bridge_mm: f64,
    },
    #[error("{file}: found {found}, expected readings at targets: {how}")]
    NoTargets { file: String, found: String, how: String },
    #[error("{message}")]
    Mapping { message: String },
    /// A mapping of columns was given for a log, or a mapping of channels for a table.
    #[error("{file}: found {found}, expected {expected}")]
    WrongMapping { file: String, found: &'static str, expected: &'static str },
    /// The error name is not valid for this use.
    #[error("{what}: found `{found}`, expected {expected}")]
    ErrorName { what: String, found: String, expected: String },
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
