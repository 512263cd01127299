//! A simulated machine: it moves along a program, has a hidden true error, heats up, and its control may run a program
//! of its own that decides what the axes get. It knows no model: the error is a function handed to it.

mod axis_log;
mod controls;
mod path;
mod plant;
mod thermometer;

pub use axis_log::{AxisLog, Given};
pub use controls::Controls;
pub use path::{Move, Path};
pub use plant::{MOST_WAYS, Machine, Plant, SimulatedController, Truth};
pub use thermometer::{SimulatedThermometer, Warming};
