#![doc = include_str!("../README.md")]

mod effects;
mod error;
mod expression;
mod sensitivity;
mod term;

pub use effects::{Effect, Poses, effects_of, effects_of_with_progress};
pub use error::SensitivityError;
pub use expression::{Expression, Factor, Grouped, Polynomial};
pub use sensitivity::{
    DEPENDENT_BELOW, Dependence, DistinctMotion, Sensitivity, sensitivity,
    sensitivity_with_progress,
};
pub use term::{ErrorTerm, terms};
pub use volcomp_kinematics as kinematics;
pub use volcomp_vocabulary as vocabulary;
