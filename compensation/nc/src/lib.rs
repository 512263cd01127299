#![doc = include_str!("../README.md")]
#![expect(clippy::needless_range_loop, reason = "an axis is an index into several lists")]

mod arcs;
mod average;
mod block;
mod codes;
mod control;
mod coordinates;
mod correction;
mod error;
mod expression;
mod fast_path;
mod flow;
mod heidenhain;
mod hole;
mod inspect;
mod interpreter;
mod line;
mod line_ends;
mod modal;
mod motion;
mod motion_queue;
mod moves;
mod notes;
mod number;
mod offsets;
mod parameters;
pub mod plan;
mod program;
mod reversal;
mod rewrite;
mod rs274;
mod run;
mod setup;
pub mod shortest;
mod siemens;
mod straight;

mod verify;

pub use average::{Average, MeanOf, Reading, average};
pub use control::{Control, Dialect};
pub use correction::Corrector;
pub use error::{BoundViolation, Fault, NcError};
pub use inspect::{Alignment, Found, InspectError, Inspected, Measured, Part, PartFeature};
pub use line_ends::LONGEST_LINE;
pub use notes::{Note, Notes};
pub use number::Decimals;
pub use program::{Job, Summary, compensate};
pub use rewrite::{Counts, Strategy};
pub use setup::SetUp;
pub use verify::{Deviation, Further, Place, Verification, Virtual, verify, verify_average};
pub use volcomp_model as model;
