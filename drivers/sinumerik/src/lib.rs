#![doc = include_str!("../README.md")]

mod config;
mod error;
mod map_nodes;
mod nodes;
#[cfg(feature = "opc-ua")]
mod opc_ua;
mod reading;
mod server;

pub use config::{CHANNEL, Sign, SinumerikConfig, lag};
pub use error::SinumerikError;
pub use map_nodes::MapNodes;
pub use nodes::Nodes;
#[cfg(feature = "opc-ua")]
pub use opc_ua::{
    InspectedAxis, Inspection, MapWords, Sensor, SinumerikController, inspect, list_axes,
    poll_temperatures,
};
pub use reading::{Reading, Value, is_switched_on};
pub use server::{PORT, SHORTEST_PERIOD, Security, Server, User};
