//! Why a form makes no model.

use volcomp_calibrate::CalibrateError;
use volcomp_model::ModelError;
use volcomp_vocabulary::{AxisName, ErrorName};

/// Why a form makes no model.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormError {
    /// More than a form is made for.
    #[error("found {found} {what}, expected at most {most}")]
    TooMany {
        /// What there is too much of.
        what: &'static str,
        /// How much of it was found.
        found: usize,
        /// The most that is taken.
        most: usize,
    },
    /// An axis that stands there twice.
    #[error("axis {axis}: found twice, expected once")]
    AxisTwice {
        /// The axis.
        axis: AxisName,
    },
    /// An error that stands there twice, typed or in files and typed.
    #[error("{error}: found twice, expected once, either typed or from files")]
    ErrorTwice {
        /// The error.
        error: ErrorName,
    },
    /// A measurement file with another ending.
    #[error("{name}: found another ending, expected a file .rtl, .rta or .csv")]
    Ending {
        /// The name of the file.
        name: String,
    },
    /// A file or folder of its own.
    #[error("a temporary folder: {0}")]
    Io(#[from] std::io::Error),
    /// The form cannot be written as a machine file.
    #[error("the machine file: {0}")]
    Toml(#[from] toml::ser::Error),
    /// The machine file is none.
    #[error("{0}")]
    Model(#[from] ModelError),
    /// A field of the form is wrong.
    #[error("{field}: {message}")]
    Field {
        /// The field, as the form names it.
        field: String,
        /// What was found and what was expected.
        message: String,
    },
    /// The measurement files make no model.
    #[error("{told}")]
    Calibrate {
        /// Why, with the files as they were chosen.
        told: String,
        /// Why, with the files as they are here.
        source: Box<CalibrateError>,
    },
}
