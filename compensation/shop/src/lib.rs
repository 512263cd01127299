#![doc = include_str!("../README.md")]

mod error;
mod instrument;
mod line_of_sight;
mod measure;
mod observation;
mod observe;
mod poses;
mod read;
mod read_observation;
mod shop;
mod wear;

pub use error::{InstrumentError, ObservationError, ShopError};
pub use instrument::{Imperfections, Instrument};
pub use line_of_sight::LineOfSight;
pub use observation::{Bar, Reads, Setting, ShopObservation};
pub use shop::{Format, Shop, ShopLine};
pub use wear::{Wear, WearError, Worn};
