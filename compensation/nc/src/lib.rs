#![doc = include_str!("../README.md")]
#![expect(
    clippy::needless_range_loop,
    reason = "an axis is a place in several lists at once"
)]

mod arc;
mod arcs;
mod average;
mod block;
mod bow;
mod carriage;
mod circle;
mod codes;
mod command;
mod control_values;
mod coordinates;
mod correction;
mod cycles;
mod dialect;
mod edits;
mod error;
mod expression;
mod fault;
mod flow;
mod formula;
mod given;
mod heidenhain;
mod hole;
mod inspect;
mod interpret;
mod legs;
mod line;
mod modal;
mod motion;
mod moves;
mod notes;
mod number;
mod offsets;
mod parameters;
mod part_file;
mod parts;
mod picture;
pub mod plan;
mod play;
mod polar;
mod program;
mod rewrite;
mod rounding;
mod run;
mod scan;
mod script;
mod setup;
pub mod shortest;
mod siemens;
mod straight;
mod stretches;
mod tip;
mod turns;
mod vector;
mod verify;
mod words;

pub use average::{Average, average};
pub use correction::Corrector;
pub use dialect::Dialect;
pub use error::NcError;
pub use fault::Fault;
pub use inspect::{Found, InspectError, Inspected};
pub use notes::{Note, Notes};
pub use part_file::{Alignment, Measured, Part, PartFeature};
pub use picture::picture;
pub use program::{Job, LONGEST_LINE, Summary, compensate};
pub use rewrite::Counts;
pub use rounding::Strategy;
pub use setup::SetUp;
pub use verify::{Deviation, Place, Verification, Virtual, verify, verify_average};
pub use volcomp_model as model;
pub use words::Decimals;
