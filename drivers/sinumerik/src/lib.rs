#![doc = include_str!("../README.md")]

mod config;
mod error;
mod nodes;
#[cfg(feature = "opc-ua")]
mod opc_ua;
mod reading;

pub use config::{
    CHANNEL, PORT, SHORTEST_PERIOD, Security, Server, Sign, SinumerikConfig, User, lag,
};
pub use error::SinumerikError;
pub use nodes::{MapNodes, Nodes};
#[cfg(feature = "opc-ua")]
pub use opc_ua::{
    InspectedAxis, Inspection, MapWords, Sensor, SinumerikController, inspect, list_axes,
    poll_temperatures,
};
pub use reading::{Reading, Value, is_switched_on};
