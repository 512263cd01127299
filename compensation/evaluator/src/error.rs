//! Why a machine cannot be compiled.

use alloc::{
    string::{String, ToString},
    vec::Vec,
};

use volcomp_kinematics::{Chain, ChainError, Structure};
use volcomp_vocabulary::{AxisName, ErrorName};

/// Why a machine cannot be compiled or its bytes cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages say what most fields are")]
pub enum EvaluatorError {
    /// A curve needs too much room.
    #[error(
        "curve {curve} needs more than 1 MiB for a tolerance of {tolerance_nm} nm (nrad), {}", expected(*.fitting_nm)
    )]
    TooLarge {
        curve: String,
        tolerance_nm: f64,
        /// A tolerance that fits, nm and nrad; `None`: there are too many breakpoints for any.
        fitting_nm: Option<f64>,
    },
    /// A curve gives something that is no finite number.
    #[error(
        "curve {curve}: found a value that is not finite near {at} (mm or deg), expected finite numbers"
    )]
    NotFinite {
        curve: String,
        /// A coordinate near the place, mm or deg.
        at: f64,
    },
    /// A tolerance that is not positive.
    #[error("found the tolerance {found}, expected a positive finite number")]
    Tolerance { found: f64 },
    /// A part of an axis that makes no sense.
    #[error("axis {axis}: {what}: expected {expected}")]
    Axis {
        axis: AxisName,
        what: &'static str,
        expected: &'static str,
    },
    /// Coordinates that are not in the order of the chain.
    #[error(
        "found coordinates in the order {}, expected the chain order of `{structure}`",
        names(found)
    )]
    AxisOrder {
        found: Vec<AxisName>,
        structure: Structure,
    },
    /// An axis of the chain that was not added.
    #[error("axis {axis} of the chain was not added, expected every axis once")]
    MissingAxis { axis: AxisName },
    /// A location error that is none, or with a value of the wrong kind.
    #[error(
        "{name}: expected a location error E?0N with a finite length (EX EY EZ) or angle (EA EB EC)"
    )]
    Location { name: ErrorName },
    /// An axis that the chain does not have.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// Bytes that are no compiled machine.
    #[error("compiled machine: {0}")]
    Blob(#[from] BlobError),
}

fn names(axes: &[AxisName]) -> String {
    let words: Vec<String> = axes.iter().map(ToString::to_string).collect();
    words.join(" ")
}

/// Why bytes are no compiled machine.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "the messages say what most fields are")]
pub enum BlobError {
    /// The bytes do not begin with the letters of a compiled machine.
    #[error("found no VOLCOMPM at its start")]
    NotABlob,
    /// The bytes are of a version that this program does not read.
    #[error("found version {found}, expected {expected}")]
    Version { found: u32, expected: u32 },
    /// The checksum does not belong to the content.
    #[error("its checksum does not fit: it was changed or cut off")]
    Checksum,
    /// The bytes end before the machine does.
    #[error("it ends too early")]
    CutOff,
    /// There are bytes behind the machine.
    #[error("it goes on behind its end")]
    TooLong,
    /// A number is NaN or infinite.
    #[error("found a number that is not finite")]
    NotFinite,
    /// More of something than a machine can have.
    #[error("found {found} {what}, expected {most} at most")]
    TooMany {
        what: &'static str,
        found: u64,
        most: usize,
    },
    /// A part of the machine that makes no sense.
    #[error("found {found}")]
    Content { found: &'static str },
    /// Geometry that a chain cannot have.
    #[error(transparent)]
    Chain(#[from] ChainError),
}

fn expected(fitting_nm: Option<f64>) -> String {
    match fitting_nm {
        Some(nm) => alloc::format!("expected a tolerance of {nm} nm or more"),
        None => "expected fewer breakpoints: no tolerance fits".into(),
    }
}

/// The error for an axis that the chain does not have.
pub(crate) fn no_axis(chain: &Chain, axis: AxisName) -> EvaluatorError {
    EvaluatorError::Chain(ChainError::NoSuchAxis {
        axis,
        structure: chain.structure().clone(),
    })
}
