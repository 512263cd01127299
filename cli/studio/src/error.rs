//! Why the studio refuses a request.

use std::io;

use volcomp_calibrate::{AnswerError, CalibrateError};
use volcomp_metrology::MetrologyError;
use volcomp_model::ModelError;
use volcomp_nc::NcError;
use volcomp_tables::axis_table::ExchangeError;

/// Why the studio refuses a request.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StudioError {
    /// A file or folder cannot be read or written.
    #[error("{place}: {source}")]
    Disk {
        /// The file or folder.
        place: String,
        /// The answer of the operating system.
        source: io::Error,
    },
    /// The folder holds more files than measurements of one machine.
    #[error(
        "{folder}: found more than {most} files, expected a folder that holds the measurement files of one machine"
    )]
    TooManyFiles {
        /// The folder.
        folder: String,
        /// The largest number of files.
        most: usize,
    },
    /// A dropped file is refused.
    #[error("{name}: {why}")]
    Upload {
        /// The name of the file.
        name: String,
        /// What was found and what is expected.
        why: String,
    },
    /// An answer is not one of the question.
    #[error(transparent)]
    Answer(#[from] AnswerError),
    /// Questions are open.
    #[error(
        "{count} open questions, the first: {first}; answer each, take its default, or leave the measurement out"
    )]
    Open {
        /// Number of open questions.
        count: usize,
        /// The file and the key of the first one.
        first: String,
    },
    /// No file of the folder can be used.
    #[error("found no measurement of this machine in the folder{reasons}")]
    NoMeasurement {
        /// Why each file is not used; empty without files.
        reasons: String,
    },
    /// There is no machine file yet.
    #[error(
        "machine.toml: not found, expected the machine file in the folder: drop it, or fill in the form"
    )]
    NoMachine,
    /// There is no result yet.
    #[error("result/machine.toml: not found: fit the measurements first")]
    NoResult,
    /// What was fitted is not what is in the folder now.
    #[error(
        "result/machine.toml: a measurement, the machine file or the calibration file has changed since the fit: fit again"
    )]
    Stale,
    /// The machine file is wrong, or cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The calibration is refused.
    #[error(transparent)]
    Calibrate(#[from] Box<CalibrateError>),
    /// A tolerance cannot be read.
    #[error("{0}")]
    Tolerance(#[from] MetrologyError),
    /// The tables are refused.
    #[error(transparent)]
    Tables(#[from] ExchangeError),
    /// The NC program is refused.
    #[error("{name}: {source}")]
    Nc {
        /// The name of the program.
        name: String,
        /// The line and the reason.
        source: Box<NcError>,
    },
    /// A value of a request is wrong.
    #[error("{key}: {why}")]
    Request {
        /// The field.
        key: &'static str,
        /// What was found and what is expected.
        why: String,
    },
    /// The gateway or the centre cannot be reached, or refuses the machine file.
    #[error("{address}: {why}")]
    Send {
        /// The address.
        address: String,
        /// Its answer, or why there is none.
        why: String,
    },
    /// The operating system refuses a socket, a thread or random numbers.
    #[error("{what}: {source}")]
    System {
        /// What was requested.
        what: &'static str,
        /// The answer of the operating system.
        source: io::Error,
    },
}

impl StudioError {
    /// A failure at a file or folder.
    pub(crate) fn disk(place: impl ToString) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Disk {
            place: place.to_string(),
            source,
        }
    }

    /// The status of HTTP.
    pub(crate) fn status(&self) -> u16 {
        match self {
            Self::Disk { .. } | Self::System { .. } => 500,
            Self::Send { .. } => 502,
            Self::NoResult | Self::Stale => 409,
            _ => 422,
        }
    }
}

impl From<CalibrateError> for StudioError {
    fn from(error: CalibrateError) -> Self {
        Self::Calibrate(Box::new(error))
    }
}
