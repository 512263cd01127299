#![doc = include_str!("../README.md")]

mod error;
mod instrument;
mod line_of_sight;
mod measure;
mod read;
mod shop;

pub use error::{InstrumentError, ShopError};
pub use instrument::{Imperfections, Instrument};
pub use line_of_sight::LineOfSight;
pub use shop::{Format, Shop, ShopLine};
