//! The reasons why a virtual shop makes no measurement files.

use volcomp_document::{InputError, ReadError};
use volcomp_metrology::MetrologyError;
use volcomp_model::ModelError;
use volcomp_vocabulary::ErrorName;

/// Why a shop makes no measurement files.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShopError {
    /// The shop file cannot be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Something in the shop file is wrong.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Something in the file of the truth machine is wrong, or the machine lacks an axis that is to be measured.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// The instrument of a line cannot be (only possible when built in code).
    #[error("the line of {error}: {source}")]
    Instrument {
        /// The error to be measured.
        error: ErrorName,
        /// The reason why the instrument is refused.
        source: InstrumentError,
    },
    /// An error cannot be measured by the method asked for (only possible when built in code).
    #[error("the line of {error}: {source}")]
    Method {
        /// The error to be measured.
        error: ErrorName,
        /// Why the method does not fit the error.
        source: MetrologyError,
    },
}

/// The reason why an instrument is refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InstrumentError {
    /// Too few or too many targets.
    #[error("found {found} targets, expected 2 to {most}")]
    Targets {
        /// The number of targets.
        found: usize,
        /// The largest number allowed.
        most: usize,
    },
    /// There is no run over the targets.
    #[error("found no runs, expected at least 1")]
    NoRuns,
    /// More readings than a line may have.
    #[error("found {targets} targets in {runs} runs, expected at most {most} readings")]
    Readings {
        /// The number of targets.
        targets: usize,
        /// The number of runs in each direction.
        runs: u32,
        /// The largest number of readings allowed.
        most: usize,
    },
    /// A number that is not finite, or negative where that has no meaning.
    #[error("{what}: found {found}, expected {expected}")]
    Number {
        /// The quantity, as the key of a shop file without its unit.
        what: &'static str,
        /// The number that was found.
        found: f64,
        /// The numbers that are allowed, in words.
        expected: &'static str,
    },
}
