#![doc = include_str!("../README.md")]

mod axis;
mod columns;
mod compile;
mod curve_file;
mod diagonals;
mod ensemble;
mod error;
mod error_rules;
mod evaluation;
mod file_names;
mod inverse;
mod machine;
mod machine_file;
mod map;
mod odd;
mod seen;
#[cfg(feature = "serde")]
mod serialised;
mod source;
mod student;
mod thermal;
mod thermal_state;
mod tool;
mod watch;

pub use axis::Axis;
pub use columns::axis_of_head;
pub use curve_file::write_curve;
pub use diagonals::{BODY_DIAGONALS, Diagonal, corrected, diagonals, quantised};
pub use ensemble::{Ensemble, Scatter};
pub use error::{CorrectRefusal, ErrorRefusal, ModelError, ThermalRefusal};
pub use inverse::Reached;
pub use machine::Machine;
pub use map::MapGrid;
pub use seen::Seen;
pub use source::MachineErrors;
pub use thermal::{Drift, Expansion, POSSIBLE_DEGC, Temperatures, Thermal};
pub use thermal_state::{Fading, ThermalState};
pub use tool::Tool;
pub use volcomp_curve as curve;
pub use volcomp_document as document;
pub use volcomp_evaluator as evaluator;
pub use volcomp_evaluator::{CompiledMachine, Tolerance};
pub use volcomp_kinematics as kinematics;
pub use volcomp_vocabulary as vocabulary;
pub use volcomp_vocabulary::{Component, ErrorName, UnknownErrorName};
