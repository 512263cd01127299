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
mod free_axis;
mod inverse;
mod largest;
mod machine;
mod machine_file;
mod map;
mod odd;
mod places;
mod provenance;
mod range;
mod rigid;
mod seen;
#[cfg(feature = "serde")]
mod serialised;
mod source;
mod thermal;
mod thermal_state;
mod tool;
mod volumetric;
mod watch;

pub use axis::Axis;
pub use columns::axis_of_head;
pub use curve_file::write_curve;
pub use diagonals::{
    BODY_DIAGONALS, DIAGONAL_TARGETS, Diagonal, corrected, diagonal_targets, diagonals, quantised,
};
pub use ensemble::{Ensemble, Scatter};
pub use error::{CorrectRefusal, ErrorRefusal, ModelError, ThermalRefusal};
pub use inverse::Reached;
pub use largest::EachKelvin;
pub use machine::Machine;
pub use map::MapGrid;
pub use provenance::{
    Origin, Provenance, ProvenanceRefusal, Source, hexadecimal, is_date, sha256_of,
};
pub use range::ErrorRange;
pub use rigid::{Lengths, RigidMotion, RigidSums};
pub use seen::Seen;
pub use source::MachineErrors;
pub use thermal::{Drift, Expansion, Temperatures, Thermal};
pub use thermal_state::{Fading, ThermalState};
pub use tool::Tool;
pub use volcomp_curve as curve;
pub use volcomp_document as document;
pub use volcomp_evaluator as evaluator;
pub use volcomp_evaluator::{CompiledMachine, Tolerance};
pub use volcomp_kinematics as kinematics;
pub use volcomp_vocabulary as vocabulary;
pub use volcomp_vocabulary::{Component, ErrorName, UnknownErrorName};
pub use volumetric::{
    ErrorField, UNCERTAINTY_POSES, VolumetricError, Worst, halton, poses_of_all_axes, volumetric,
};
