#![doc = include_str!("../README.md")]

mod error;
mod instrument;
mod measure;
mod observe;
mod poses;
mod read;
mod shop;
mod wear;

pub use error::{InstrumentError, ObservationError, ShopError};
pub use instrument::{Imperfections, Instrument};
pub use poses::{Plan, PlannedPose};
pub use shop::{
    Bar, CALIBRATED, Format, Header, Poses, Reads, Setting, Shop, ShopLine, ShopLocation,
    ShopObservation,
};
pub use volcomp_calibrate::LineOfSight;
pub use wear::{Wear, WearError, Worn};
