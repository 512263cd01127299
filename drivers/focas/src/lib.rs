#![doc = include_str!("../README.md")]

mod answers;
mod client;
mod config;
mod controller;
mod error;
pub mod frame;
mod map_words;
mod parameters;
mod plan;
mod pmc;
mod reading;
mod session;
#[cfg(feature = "simulator")]
pub mod simulator;

/// Default TCP port of controls.
pub const PORT: u16 = 8193;

pub use answers::{Alarm, PositionKind, StatusInfo, SystemInfo};
pub use client::Client;
pub use config::{FocasConfig, Shift};
pub use controller::{FocasController, Inspection, inspect};
pub use error::{FocasError, ReturnCode};
pub use map_words::{MapPlaces, MapWords};
pub use parameters::ShiftSource;
pub use plan::{Abilities, Packing};
pub use pmc::{BarrierArea, Block, PmcAddress, PmcArea, Width};
pub use session::Session;
