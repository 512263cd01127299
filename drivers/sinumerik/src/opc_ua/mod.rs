//! The connection over OPC UA: a thread of its own for each control, which reads in periods and writes what is asked for.

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
