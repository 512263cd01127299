#![no_std]
#![doc = include_str!("../README.md")]

mod axis;
mod direction;
mod error_name;
mod per_axis;
#[cfg(feature = "serde")]
mod serialised;
mod units;

pub use axis::{AxisKind, AxisName, MAX_AXES, UnknownAxis};
pub use direction::{Direction, UnknownDirection};
pub use error_name::{Component, ErrorName, UnknownErrorName};
pub use per_axis::{PerAxis, PerChannel};
pub use units::{Coordinate, Deg, Degc, Displacement, Mm, Rad, Um, Unit, Urad};
