use std::path::PathBuf;

use volcomp_document::{InputError, ReadError};
use volcomp_fit::FitError;
use volcomp_identify::IdentifyError;
use volcomp_metrology::MetrologyError;
use volcomp_model::ModelError;
use volcomp_vocabulary::{AxisName, ErrorName};

/// Reason why a calibration file cannot be read or does not give a machine.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CalibrateError {
    /// The calibration file could not be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Invalid entry in the calibration file.
    #[error(transparent)]
    Input(#[from] InputError),
    /// Invalid machine file.
    #[error(transparent)]
    Machine(#[from] ModelError),
    /// The unknowns cannot be identified from the observations.
    #[error(transparent)]
    Identify(IdentifyError),
    /// The hash of a file that was read before cannot be computed.
    #[error("{}: {source}", .file.display())]
    Hash { file: PathBuf, source: std::io::Error },
    /// A measurement file cannot be read, or its content is invalid.
    #[error(transparent)]
    Measurement(#[from] MetrologyError),
    /// The readings of a file cannot be converted to the profile or slope of the error that they measure.
    #[error("{error} from {}: {source}", .file.display())]
    Profile { error: ErrorName, file: PathBuf, source: Box<MetrologyError> },
    #[error("{error} from {}: found no readings, expected at least one", named(.files))]
    NoReadings { error: ErrorName, files: Vec<PathBuf> },
    /// No curve can be fitted to the readings of an error.
    #[error("{error} from {}: {source}", named(.files))]
    Fit { error: ErrorName, files: Vec<PathBuf>, source: FitError },
    #[error(
        "{error} from {}: along the oblique axis {axis} it fills {other} too, which was measured separately",
        named(.files)
    )]
    Oblique { error: ErrorName, files: Vec<PathBuf>, axis: AxisName, other: ErrorName },
    #[error(
        "the unknowns did not settle in {rounds} rounds, each with the lines cleared of what was found before: the last moved one by {moved:.2} of its standard uncertainty; expected lines and observations that hold the unknowns apart: measure the other tilt of the rotary axis, too, or leave out the unknown that the lines contain"
    )]
    NotSettled { rounds: usize, moved: f64 },
    #[error(
        "{error} from {}: the diagonals do not determine it, expected the two face diagonals of its plane or the four body diagonals",
        named(.files)
    )]
    Diagonals { error: ErrorName, files: Vec<PathBuf> },
    #[error("{squareness}: {straightness} was not measured, expected its line or `value_urad`")]
    NoSlope { squareness: ErrorName, straightness: ErrorName },
}

impl From<IdentifyError> for CalibrateError {
    /// Maps errors in files to the same variants that the reader of this crate returns.
    fn from(error: IdentifyError) -> Self {
        match error {
            IdentifyError::Read(error) => Self::Read(error),
            IdentifyError::Input(error) => Self::Input(error),
            IdentifyError::Machine(error) => Self::Machine(error),
            other => Self::Identify(other),
        }
    }
}

fn named(files: &[PathBuf]) -> String {
    let names: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
    names.join(", ")
}
