#![cfg_attr(not(feature = "std"), no_std)]
#![doc = include_str!("../README.md")]
#![allow(
    clippy::inline_always,
    reason = "measured: a call costs as much as the work, and code that is not inlined is not compiled for wide registers"
)]

extern crate alloc;

#[cfg(feature = "std")]
mod batch;
mod blob;
mod build;
mod chord;
mod correction;
mod error;
mod fit;
mod fold;
#[cfg(feature = "std")]
mod grid;
mod index;
mod machine;
mod neglected;
mod parts;
mod patch;
mod single;
mod slides;
mod table;
mod terms;
mod turn;
mod walk;

pub use blob::BLOB_VERSION;
pub use correction::{CorrectionParts, FirstOrder};
pub use error::{BlobError, EvaluatorError};
#[cfg(feature = "std")]
pub use grid::LinearGrid;
pub use machine::{CompiledMachine, Evaluation, OutsideRange};
pub use neglected::Neglected;
pub use parts::{AxisParts, MachineParts, RawCurve, Tolerance};
pub use patch::Patch;
pub use slides::Slides;
pub use volcomp_kinematics as kinematics;
pub use volcomp_vocabulary as vocabulary;
