#![doc = include_str!("../README.md")]

mod adrift;
mod age;
mod command;
mod controller;
mod datagram;
mod ini;
mod key;
mod look;
mod state;

pub use command::{COMMAND_BYTES, Command, Content};
pub use controller::{Health, LinuxCncConfig, LinuxCncController};
pub use datagram::Broken;
pub use ini::{Expected, Ini, Least, Problem};
pub use key::{Key, KeyError};
pub use look::look;
pub use state::{AxisState, Flag, Flags, STATE_BYTES, State};

/// Default UDP port of a bridge.
pub const PORT: u16 = 47_001;

/// Protocol version.
pub const VERSION: u8 = 2;
