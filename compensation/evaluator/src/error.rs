use alloc::{format, string::String};

/// Why a machine cannot be compiled or a blob not be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluatorError {
    /// A curve needs too much room.
    #[error(
        "curve {curve} needs more than 1 MiB for {tolerance_nm} nm (nrad), {}", expected(*.fitting_nm)
    )]
    TooLarge {
        /// Its name, or the axis whose curves do not fit together.
        curve: String,
        /// The tolerance asked for, nm and nrad.
        tolerance_nm: f64,
        /// A tolerance that fits, nm and nrad; `None`: there are too many breakpoints for any.
        fitting_nm: Option<f64>,
    },
    /// A tolerance that is not positive.
    #[error("found the tolerance {found}, expected a positive finite number")]
    Tolerance {
        /// The number.
        found: f64,
    },
    /// Bytes that are no compiled machine.
    #[error("compiled machine: {reason}")]
    Blob {
        /// Why not.
        reason: String,
    },
}

fn expected(fitting_nm: Option<f64>) -> String {
    match fitting_nm {
        Some(nm) => format!("expected a tolerance of {nm} nm or more"),
        None => "expected fewer breakpoints: no tolerance fits".into(),
    }
}
