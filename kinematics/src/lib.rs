#![cfg_attr(not(feature = "std"), no_std)]
#![doc = include_str!("../README.md")]

mod axis;
mod chain;
mod correction;
mod correctors;
mod denavit_hartenberg;
mod dependent;
mod error;
mod error_form;
mod given_errors;
mod inverse;
pub mod least_norm;
mod math;
mod no_effect;
mod pose;
mod source;
mod structure;
mod twist;
mod zero_position;

pub use axis::letter_direction;
pub use chain::{Chain, Joint, MotionFrame};
pub use correction::{Correction, CorrectionOptions, correct};
pub use correctors::{Correctors, INDEPENDENT_ABOVE};
pub use denavit_hartenberg::{DhConvention, DhRow, DhTable};
pub use error::{ChainError, InsteadConstant, NoEffect};
pub use error_form::{
    Form, UnknownForm, VolumetricError, actual_point_mm, actual_pose, volumetric_error,
};
pub use given_errors::GivenErrors;
pub use inverse::{NoSolution, Pointing, REACHED_WITHIN_MM};
pub use least_norm::{LEFT_OUT_BELOW, NEAR_SINGULAR_BELOW, SINGULAR_BELOW};
pub use nalgebra;
pub use no_effect::along_machine_axis;
pub use pose::{
    Pose, rotation_about_axis, rotation_from_vector, skew_part, small_rotation,
    vector_from_rotation,
};
pub use source::{ErrorMotion, ErrorSource, State};
pub use structure::{Side, Structure, StructureError, TypeNumbers};
pub use twist::{Screw, Twist};
pub use volcomp_vocabulary as vocabulary;
pub use zero_position::ZeroPositionError;
