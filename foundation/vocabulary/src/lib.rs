#![no_std]
#![doc = include_str!("../README.md")]

mod axis;
pub mod bounds;
mod direction;
mod error_name;
#[cfg(feature = "serde")]
mod serialised;
mod units;

pub use axis::{
    AxisKind, AxisName, COORDINATE_ROUNDING, MAX_AXES, PerAxis, PerChannel, UnknownAxis,
    brought_into, is_within,
};
pub use bounds::{CorrectionLimit, CorrectionLimitError};
pub use direction::{Direction, TURNED_AFTER, TURNED_AFTER_ROTARY, UnknownDirection};
pub use error_name::{Component, ErrorName, UnknownErrorName};
pub use units::{Coordinate, Deg, Degc, Displacement, Mm, Rad, Um, Unit, Urad};
