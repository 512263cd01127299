use alloc::string::String;

use volcomp_kinematics::AxisName;

/// Why a machine cannot be compiled or a blob not be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluatorError {
    /// The curves of one axis need too much room.
    #[error(
        "the curves of axis {axis} need more than 1 MiB for {tolerance_nm} nm (nrad): expected a tolerance of {fitting_nm} nm or more"
    )]
    TooLarge {
        /// The axis.
        axis: AxisName,
        /// The tolerance asked for, nm and nrad.
        tolerance_nm: f64,
        /// A tolerance that fits, nm and nrad; infinite when none was found.
        fitting_nm: f64,
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
