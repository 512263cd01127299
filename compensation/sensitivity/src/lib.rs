#![doc = include_str!("../README.md")]

mod chunks;
mod dependence;
mod effects;
mod error;
mod expression;
mod gaps;
mod polynomial;
mod poses;
mod sensitivity;
mod term;

pub use dependence::{DEPENDENT_BELOW, Dependence};
pub use effects::{Effect, effects_of, effects_of_with_progress};
pub use error::SensitivityError;
pub use expression::{Expression, Grouped};
pub use polynomial::{Factor, Polynomial};
pub use poses::Poses;
pub use sensitivity::{DistinctMotion, Sensitivity, sensitivity, sensitivity_with_progress};
pub use term::{ErrorTerm, terms};
pub use volcomp_kinematics as kinematics;
pub use volcomp_vocabulary as vocabulary;
