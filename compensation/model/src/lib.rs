#![doc = include_str!("../README.md")]

mod compile;
mod curve_file;
mod diagonals;
mod ensemble;
mod error;
mod machine;
mod machine_file;
mod map;
mod source;
mod thermal;
mod thermal_state;

pub use curve_file::write_curve;
pub use diagonals::{Diagonal, corrected, diagonals, quantised};
pub use ensemble::Ensemble;
pub use error::ModelError;
pub use machine::{Axis, Machine, Tool};
pub use map::MapGrid;
pub use source::MachineErrors;
pub use thermal::{Drift, Expansion, Temperatures, Thermal};
pub use thermal_state::{Fading, ThermalState};
pub use volcomp_document as document;
pub use volcomp_evaluator as evaluator;
pub use volcomp_evaluator::{CompiledMachine, Tolerance};
pub use volcomp_vocabulary::{Component, ErrorName, UnknownErrorName};
