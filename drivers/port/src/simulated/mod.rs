//! A simulated machine: it runs a part program, has a hidden true error and heats up. Its control may run a program that determines the
//! corrections of the axes. It uses no model: the error is a function passed to it.

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
