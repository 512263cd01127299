#![doc = include_str!("../README.md")]

mod client;
mod controller;
pub mod frame;
mod session;
#[cfg(feature = "simulator")]
pub mod simulator;

pub use client::{Alarm, Client, PmcArea, PositionKind, StatusInfo, SystemInfo, Width};
pub use controller::{FocasConfig, FocasController, PmcAddress, Shift};
pub use session::Session;
