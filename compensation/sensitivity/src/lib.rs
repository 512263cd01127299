#![doc = include_str!("../README.md")]

mod dependence;
mod effects;
mod expression;
mod gaps;
mod polynomial;
mod poses;
mod sensitivity;
mod term;

pub use dependence::{DEPENDENT_BELOW, Dependence};
pub use effects::{Effect, effects_of};
pub use expression::{Expression, Grouped};
pub use polynomial::{Factor, Polynomial};
pub use poses::Poses;
pub use sensitivity::{DistinctMotion, Sensitivity, SensitivityError, sensitivity};
pub use term::{ErrorTerm, terms};
pub use volcomp_kinematics as kinematics;
pub use volcomp_vocabulary as vocabulary;
