//! The connection over OPC UA. One thread per control reads periodically, and writes on request.

mod controller;
mod failure_log;
mod inspection;
mod link;
mod socket;
mod thermometer;
mod trust;
mod words;
mod worker;

pub use controller::SinumerikController;
pub use inspection::{InspectedAxis, Inspection, inspect, list_axes};
pub use thermometer::{Sensor, poll_temperatures};
pub use words::MapWords;
