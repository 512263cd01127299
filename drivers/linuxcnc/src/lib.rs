#![doc = include_str!("../README.md")]

mod age;
mod command;
mod controller;
mod datagram;
mod ini;
mod key;
mod offset_monitor;
mod socket;
mod state;

pub use command::{COMMAND_BYTES, Command, Content};
pub use controller::{Health, LinuxCncConfig, LinuxCncController};
pub use datagram::DatagramError;
pub use ini::{Expected, GuardMinimum, Ini, Problem};
pub use key::{Key, KeyError};
pub use socket::read_state;
pub use state::{AxisState, Flag, Flags, STATE_BYTES, State};

/// Default UDP port of a bridge.
pub const PORT: u16 = 47_001;

/// Version of the datagram protocol. Datagrams of another version are rejected.
pub const VERSION: u8 = 2;
