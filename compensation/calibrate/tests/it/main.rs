//! Calibrations of readings computed from a known machine give its volumetric error.

mod answers;
mod draft;
mod gantry;
mod incomplete_runs;
mod lab;
mod located;
mod messages;
mod observed;
mod parallel;
mod provenance;
mod squares;
mod turning;
mod uncertainty;
mod wrong_values;
