#![cfg_attr(not(feature = "std"), no_std)]
#![doc = include_str!("../README.md")]

mod chain;
mod conversions;
mod correction;
mod correctors;
mod error;
mod error_form;
mod inverse;
pub mod least_norm;
mod math;
mod pose;
mod structure;

pub use chain::{
    Chain, ErrorMotion, ErrorSource, Joint, MotionFrame, State, along_machine_axis,
    letter_direction,
};
pub use conversions::{DhConvention, DhRow, DhTable, ZeroPositionError};
pub use correction::{Correction, CorrectionOptions, correct};
pub use correctors::{Correctors, INDEPENDENT_ABOVE};
pub use error::{ChainError, InsteadConstant, NoEffect};
pub use error_form::{
    Form, GivenErrors, UnknownForm, VolumetricError, actual_point_mm, actual_pose, volumetric_error,
};
pub use inverse::{NoSolution, Pointing, REACHED_WITHIN_MM};
pub use least_norm::{LEFT_OUT_BELOW, NEAR_SINGULAR_BELOW, SINGULAR_BELOW};
pub use nalgebra;
pub use pose::{
    Pose, Screw, Twist, rotation_about_axis, rotation_from_vector, skew_part, small_rotation,
    vector_from_rotation,
};
pub use structure::{Side, Structure, StructureError, TypeNumbers};
pub use volcomp_vocabulary as vocabulary;
