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
mod bound;
mod build;
mod correction;
mod error;
mod machine;
mod parts;
mod table;
mod turn;
mod walk;

#[cfg(feature = "std")]
pub use batch::LinearGrid;
pub use blob::BLOB_VERSION;
pub use bound::Neglected;
pub use correction::{CorrectionParts, FirstOrder, Slides};
pub use error::{BlobError, EvaluatorError};
pub use machine::{CompiledMachine, Evaluation, OutsideRange};
pub use parts::{AxisParts, MachineParts, RawCurve, Tolerance};
pub use table::Patch;
pub use volcomp_kinematics as kinematics;
pub use volcomp_vocabulary as vocabulary;
