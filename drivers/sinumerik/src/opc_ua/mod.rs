//! The connection over OPC UA: one thread per control, which reads periodically and writes on request.

mod controller;
mod inspection;
mod link;
mod socket;
mod thermometer;
mod trouble;
mod trust;
mod words;
mod worker;

pub use controller::SinumerikController;
pub use inspection::{InspectedAxis, Inspection, inspect, look};
pub use thermometer::{Sensor, SinumerikThermometer};
pub use words::MapWords;
