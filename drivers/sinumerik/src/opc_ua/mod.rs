//! The connection over OPC UA. One thread per control reads periodically, and writes on request.

mod inspection;
mod link;
mod thermometer;
mod trust;
mod words;
mod worker;

pub use inspection::{InspectedAxis, Inspection, inspect, list_axes};
pub use thermometer::{Sensor, poll_temperatures};
pub use words::MapWords;
pub use worker::SinumerikController;
