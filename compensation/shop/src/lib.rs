#![doc = include_str!("../README.md")]

mod error;
mod file;
mod instrument;
mod measure;
mod observation;
mod observe;
mod plan;
mod poses;
mod read;
mod read_observation;
mod shop;
mod size;
mod wear;

pub use error::{InstrumentError, ObservationError, ShopError};
pub use instrument::{Imperfections, Instrument};
pub use observation::{Bar, Poses, Reads, Setting, ShopObservation};
pub use plan::{Plan, PlannedPose};
pub use shop::{CALIBRATED, Format, Header, Shop, ShopLine, ShopLocation};
pub use volcomp_calibrate::LineOfSight;
pub use wear::{Wear, WearError, Worn};
