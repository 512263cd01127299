#![doc = include_str!("../README.md")]
#![expect(
    clippy::needless_range_loop,
    reason = "an axis is a place in several lists at once"
)]

mod arc;
mod block;
mod codes;
mod coordinates;
mod correction;
mod error;
mod expression;
mod fault;
mod flow;
mod interpret;
mod modal;
mod motion;
mod notes;
mod number;
mod parameters;
mod program;
mod rewrite;
mod rewrite_arc;
mod run;
mod scan;
mod setup;
mod words;

pub use correction::Corrector;
pub use error::NcError;
pub use fault::Fault;
pub use notes::{Note, Notes};
pub use program::{LONGEST_LINE, Summary, compensate};
pub use rewrite::Counts;
pub use setup::SetUp;
pub use volcomp_model as model;
pub use words::Decimals;
