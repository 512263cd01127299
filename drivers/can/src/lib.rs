#![doc = include_str!("../README.md")]

#[cfg(feature = "socket")]
mod arrival;
mod barrier;
mod bridge;
pub mod canopen;
mod dbc;
mod frame;
mod plain;
mod quantity;
mod receiver;
mod signals;
#[cfg(feature = "socket")]
mod socket;
mod thermometer;

pub use bridge::{BridgeConfig, CanController};
pub use dbc::DbcError;
pub use frame::{CanPort, Frame, Received};
pub use receiver::Health;
pub use signals::{Message, Signal, SignalTable, checksum};
#[cfg(feature = "socket")]
pub use socket::CanSocket;
pub use thermometer::{CanThermometer, temperature_names};

/// Text of the shipped DBC file for plain frames.
pub const SHIPPED_DBC: &str = include_str!("../volcomp.dbc");

/// Text of the shipped DBC file for a control with a barrier and the axes X, Y and Z.
pub const BARRIER_DBC: &str = include_str!("../barrier.dbc");
