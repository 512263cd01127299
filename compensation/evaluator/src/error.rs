use alloc::{
    string::{String, ToString},
    vec::Vec,
};

use volcomp_kinematics::{Chain, ChainError, Structure};
use volcomp_vocabulary::{AxisName, ErrorName};

/// Why a machine cannot be compiled or its bytes cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EvaluatorError {
    #[error(
        "curve {curve} needs more than 1 MiB for a tolerance of {tolerance_nm} nm (nrad), {}", expected(*.fitting_nm)
    )]
    TooLarge {
        curve: String,
        tolerance_nm: f64,
        /// A tolerance, nm and nrad, with which all curves of the axis stay within 1 MiB; `None` if no
        /// tolerance up to 10⁹ times the requested one suffices.
        fitting_nm: Option<f64>,
    },
    #[error(
        "curve {curve}: found a value that is not finite near {at} (mm or deg), expected finite numbers"
    )]
    NotFinite {
        curve: String,
        /// A coordinate near the value, mm or deg.
        at: f64,
    },
    #[error("found the tolerance {found}, expected a positive finite number")]
    Tolerance { found: f64 },
    #[error("axis {axis}: {what}: expected {expected}")]
    Axis { axis: AxisName, what: &'static str, expected: &'static str },
    #[error(
        "found coordinates in the order {}, expected the chain order of `{structure}`",
        names(found)
    )]
    AxisOrder { found: Vec<AxisName>, structure: Structure },
    #[error("axis {axis} of the chain was not added, expected every axis once")]
    MissingAxis { axis: AxisName },
    #[error(
        "{name}: expected a location error E?0N with a finite length (EX EY EZ) or angle (EA EB EC)"
    )]
    Location { name: ErrorName },
    /// An axis that the chain does not have.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// The bytes are not a compiled machine.
    #[error("compiled machine: {0}")]
    Blob(#[from] BlobError),
}

fn names(axes: &[AxisName]) -> String {
    let words: Vec<String> = axes.iter().map(ToString::to_string).collect();
    words.join(" ")
}

/// Why bytes are not a compiled machine.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum BlobError {
    #[error("found no VOLCOMPM at its start")]
    NotABlob,
    #[error("found version {found}, expected {expected}")]
    Version { found: u32, expected: u32 },
    #[error("its checksum does not fit: it was changed or cut off")]
    Checksum,
    #[error("it ends too early")]
    CutOff,
    #[error("it goes on behind its end")]
    TooLong,
    #[error("found a number that is not finite")]
    NotFinite,
    #[error("found {found} {what}, expected {most} at most")]
    TooMany { what: &'static str, found: u64, most: usize },
    /// An invalid part of the machine.
    #[error("found {found}")]
    Content { found: &'static str },
    /// Geometry from which no kinematic chain can be built.
    #[error(transparent)]
    Chain(#[from] ChainError),
}

fn expected(fitting_nm: Option<f64>) -> String {
    match fitting_nm {
        Some(nm) => alloc::format!("expected a tolerance of {nm} nm or more"),
        None => "expected fewer breakpoints: no tolerance fits".into(),
    }
}

pub(crate) fn no_axis(chain: &Chain, axis: AxisName) -> EvaluatorError {
    EvaluatorError::Chain(ChainError::NoSuchAxis { axis, structure: chain.structure().clone() })
}
