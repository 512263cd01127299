//! Whether the temperatures of a machine may be used: the one place where that is decided. Drivers only tell what
//! they heard and when.

mod check;
mod judge;
mod neighbours;
mod readmission;
mod types;

pub use check::SensorCheck;
pub use judge::judge_temperatures;
pub use types::{Heard, MAX_SENSORS, SensorFlaw, SensorLimits, SensorReport};
