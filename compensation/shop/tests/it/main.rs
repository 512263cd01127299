//! The virtual shop: what it makes, what it refuses, and against calibration, which reads what it makes.

mod held_rotary;
mod messages;
mod round_trip;
