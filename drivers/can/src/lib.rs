#![doc = include_str!("../README.md")]

mod bridge;
pub mod canopen;
mod frame;
mod quantity;
mod signals;
#[cfg(feature = "socket")]
mod socket;

pub use bridge::{BridgeConfig, CanController, CanThermometer, Health, temperature_names};
pub use frame::{CanPort, Frame, Received};
pub use signals::{DbcError, Message, Signal, SignalTable, checksum};
#[cfg(feature = "socket")]
pub use socket::CanSocket;

/// The shipped description of the plain frames.
pub const SHIPPED_DBC: &str = include_str!("../volcomp.dbc");
