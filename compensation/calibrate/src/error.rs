//! What can be wrong with a calibration.

use volcomp_document::{InputError, ReadError};
use volcomp_metrology::MetrologyError;
use volcomp_model::ModelError;

use crate::track::Track;

/// Why measurement files do not make a machine file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrateError {
    /// The calibration or shop file cannot be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Something in the calibration file is wrong.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Something in the machine file is wrong.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// Something in a measurement file is wrong.
    #[error(transparent)]
    Measurement(#[from] MetrologyError),
    /// The readings of an error cannot be used.
    #[error("{error} from {file}: {reason}")]
    Readings {
        /// The error measured.
        error: String,
        /// The measurement files.
        file: String,
        /// Why not.
        reason: String,
    },
}

impl CalibrateError {
    /// Why the lines of an error cannot be used.
    pub(crate) fn readings(tracks: &[Track<'_>], reason: &dyn std::fmt::Display) -> Self {
        let error = tracks
            .first()
            .map(|track| track.line.setup.error.to_string());
        let files: Vec<String> = tracks
            .iter()
            .map(|track| track.line.file.display().to_string())
            .collect();
        Self::Readings {
            error: error.unwrap_or_default(),
            file: files.join(", "),
            reason: reason.to_string(),
        }
    }
}
