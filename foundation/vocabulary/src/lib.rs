#![no_std]
#![doc = include_str!("../README.md")]

mod axis;
pub mod bounds;
mod direction;
mod error_name;
mod per_axis;
mod range;
#[cfg(feature = "schema")]
mod schema;
#[cfg(feature = "serde")]
mod serialised;
mod units;

pub use axis::{AxisKind, AxisName, MAX_AXES, UnknownAxis};
pub use bounds::{CorrectionLimit, CorrectionLimitError};
pub use direction::{Direction, TURNED_AFTER, TURNED_AFTER_ROTARY, UnknownDirection};
pub use error_name::{Component, ErrorName, UnknownErrorName};
pub use per_axis::{PerAxis, PerChannel};
pub use range::{COORDINATE_ROUNDING, brought_into, is_within};
pub use units::{Coordinate, Deg, Degc, Displacement, Mm, Rad, Um, Unit, Urad};
