//! Errors of the studio, and the interrupt that ends a request with an error.

use std::{
    io,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
};

use volcomp_calibrate::{AnswerError, CalibrateError};
use volcomp_metrology::MetrologyError;
use volcomp_model::ModelError;
use volcomp_nc::NcError;
use volcomp_tables::axis_table::ExchangeError;

/// Why the studio rejects a request.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StudioError {
    /// A file or folder cannot be read or written.
    #[error("{place}: {source}")]
    Disk {
        /// Path of the file or folder.
        place: String,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The folder holds more files than measurements of one machine can have.
    #[error(
        "{folder}: found more than {most} files, expected a folder that holds the measurement files of one machine"
    )]
    TooManyFiles {
        folder: String,
        /// Maximum number of files.
        most: usize,
    },
    /// An uploaded file is rejected.
    #[error("{name}: {why}")]
    Upload {
        /// Name of the uploaded file.
        name: String,
        /// Reason with the found and the expected value.
        why: String,
    },
    /// An answer is invalid for its question.
    #[error(transparent)]
    Answer(#[from] AnswerError),
    /// The fit needs answers to questions that are still open.
    #[error(
        "{count} open questions, the first: {first}; answer each, take its default, or leave the measurement out"
    )]
    Open {
        /// Number of unanswered questions.
        count: usize,
        /// File and key of the first open question.
        first: String,
    },
    /// No file of the folder is usable.
    #[error("found no measurement of this machine in the folder{reasons}")]
    NoMeasurement {
        /// The reason for each file; empty if the folder has no files.
        reasons: String,
    },
    /// The folder has no machine file yet.
    #[error(
        "machine.toml: not found, expected the machine file in the folder: drop it, or fill in the form"
    )]
    NoMachine,
    /// The folder has no result yet.
    #[error("result/machine.toml: not found: fit the measurements first")]
    NoResult,
    #[error(
        "result/machine.toml: a measurement, the machine file or the calibration file has changed since the fit: fit again"
    )]
    Stale,
    /// The machine file is invalid, or cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// The measurements cannot be calibrated.
    #[error(transparent)]
    Calibrate(#[from] Box<CalibrateError>),
    #[error("{0}")]
    Tolerance(#[from] MetrologyError),
    /// The tables cannot be exported.
    #[error(transparent)]
    Tables(#[from] ExchangeError),
    /// The NC program cannot be compensated.
    #[error("{name}: {source}")]
    Nc {
        /// File name of the program.
        name: String,
        /// The line and the reason.
        source: Box<NcError>,
    },
    /// A value of a request is invalid.
    #[error("{key}: {why}")]
    Request {
        /// Field of the request.
        key: &'static str,
        /// Reason with the found and the expected value.
        why: String,
    },
    /// The gateway or the centre cannot be reached, or rejects the machine file.
    #[error("{address}: {why}")]
    Send {
        /// URL of the gateway or the centre.
        address: String,
        /// Response of the gateway or the centre, or the reason why the response is missing.
        why: String,
    },
    /// The user cancelled the request.
    #[error("cancelled: nothing was changed in the folder")]
    Cancelled,
    /// The operating system provides no socket, thread or random numbers.
    #[error("{what}: {source}")]
    System {
        /// Name of the missing socket, thread or random numbers.
        what: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
}

impl StudioError {
    pub(crate) fn disk(place: impl ToString) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Disk { place: place.to_string(), source }
    }

    pub(crate) fn status(&self) -> u16 {
        match self {
            Self::Disk { .. } | Self::System { .. } => 500,
            Self::Send { .. } => 502,
            Self::NoResult | Self::Stale | Self::Cancelled => 409,
            _ => 422,
        }
    }
}

impl From<CalibrateError> for StudioError {
    fn from(error: CalibrateError) -> Self {
        Self::Calibrate(Box::new(error))
    }
}

/// Counts the cancellations. A request is cancelled if the count has changed since it began, so a cancellation never
/// affects a later request.
#[derive(Clone, Debug, Default)]
pub(crate) struct Interrupt {
    cancellations: Arc<AtomicU64>,
    at_begin: u64,
}

impl Interrupt {
    /// The interrupt of a request that begins now.
    pub(crate) fn of_request(&self) -> Self {
        let cancellations = Arc::clone(&self.cancellations);
        Self { at_begin: cancellations.load(Ordering::SeqCst), cancellations }
    }

    /// Cancels every request that has begun.
    pub(crate) fn cancel(&self) {
        self.cancellations.fetch_add(1, Ordering::SeqCst);
    }

    pub(crate) fn is_cancelled(&self) -> bool {
        self.cancellations.load(Ordering::SeqCst) != self.at_begin
    }

    /// Called before the first file of a set is written, so that a set is written completely or not at all.
    pub(crate) fn check(&self) -> Result<(), StudioError> {
        if self.is_cancelled() { Err(StudioError::Cancelled) } else { Ok(()) }
    }
}
