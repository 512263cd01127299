#![doc = include_str!("../README.md")]

mod axis;
mod compile;
mod curve_file;
mod diagonals;
mod error;
mod inverse;
mod machine;
mod machine_file;
mod provenance;
mod range;
mod thermal;
mod thermal_state;
mod volumetric;

pub use axis::{Axis, Tool, axis_of_head};
pub use compile::FINE_CURVES_NM;
pub use curve_file::write_curve;
pub use diagonals::{
    BODY_DIAGONALS, DIAGONAL_TARGETS, Diagonal, MapGrid, corrected, diagonal_targets, diagonals,
    quantised, residual,
};
pub use error::{CorrectRefusal, ErrorRefusal, ModelError, ThermalRefusal};
pub use inverse::Reached;
pub use machine::{Machine, MachineErrors};
pub use provenance::{
    Origin, Provenance, ProvenanceRefusal, Source, hexadecimal, is_date, sha256_of,
};
pub use range::{EachKelvin, ErrorRange};
pub use thermal::{Drift, Expansion, Seen, Temperatures, Thermal};
pub use thermal_state::{Fading, ThermalState};
pub use volcomp_curve as curve;
pub use volcomp_document as document;
pub use volcomp_evaluator as evaluator;
pub use volcomp_evaluator::{CompiledMachine, Tolerance};
pub use volcomp_kinematics as kinematics;
pub use volcomp_vocabulary as vocabulary;
pub use volcomp_vocabulary::{Component, ErrorName, UnknownErrorName};
pub use volumetric::{
    ErrorField, Lengths, RigidMotion, RigidSums, UNCERTAINTY_POSES, VolumetricError, Worst, halton,
    poses_of_all_axes, volumetric,
};
