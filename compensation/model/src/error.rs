//! What can be wrong with a machine file.

use volcomp_document::{InputError, ReadError};
use volcomp_kinematics::ChainError;
use volcomp_vocabulary::AxisName;

/// Why a machine file is refused or a machine cannot answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The file cannot be read as text.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Something in the file is wrong.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The machine has no such axis.
    #[error("machine `{machine}` with structure `{structure}` has no axis {axis}")]
    NoSuchAxis {
        /// Name of the machine.
        machine: String,
        /// Its structure.
        structure: String,
        /// The axis asked for.
        axis: AxisName,
    },
    /// The machine file has no such tool.
    #[error("machine `{machine}` has no tool `{tool}`, expected one of: {known}")]
    NoSuchTool {
        /// Name of the machine.
        machine: String,
        /// The tool asked for.
        tool: String,
        /// The tools there are.
        known: String,
    },
    /// A coordinate that is no number.
    #[error("axis {axis}: coordinate is {found}, expected a finite number")]
    Coordinate {
        /// The axis.
        axis: AxisName,
        /// The value.
        found: f64,
    },
    /// An error that a chain cannot have.
    #[error("{error}: {reason}")]
    Error {
        /// Name of the error.
        error: String,
        /// Why it is refused.
        reason: String,
    },
    /// Geometry that a chain cannot have.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// The compiled form cannot be made.
    #[error("{machine}: {error}")]
    Compile {
        /// Name of the machine.
        machine: String,
        /// Why not.
        error: volcomp_evaluator::EvaluatorError,
    },
}
