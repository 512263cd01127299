//! A simulated machine that runs a part program, has a true error and warms up. Its control may run a program that
//! determines the corrections of the axes. The true error is a given function, and independent of the error model under
//! test.

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
