#![doc = include_str!("../README.md")]

mod ball_row;
mod basis;
mod candidates;
mod checked;
mod checks;
mod coefficients;
mod columns;
mod derivatives;
mod design;
mod draws;
mod effects;
mod equation;
mod error;
mod followers;
mod found_machine;
mod identify;
mod judge;
mod left_open;
mod next;
mod observations;
mod parameters;
mod params;
mod penalty;
mod prepared;
mod products;
mod rank;
mod read;
mod response;
mod rows;
mod seen_columns;
mod setup_keys;
mod sides;
mod solve;
mod start;
mod system;
mod timeline;
mod uncertain;
mod unknown_file;
mod values;

pub use basis::Basis;
pub use checked::standard_uncertainty_um;
pub use draws::Draws;
pub use error::{FarFile, IdentifyError};
pub use followers::Follower;
pub use found_machine::machine_with;
pub use identify::{Identification, identify, identify_followed};
pub use judge::{Figures, LeftOut};
pub use left_open::LeftOpen;
pub use next::Next;
pub use observations::{
    Kind, NumberKind, Observation, Observations, Quantity, Row, SecondAxis, Seen, SetUp, Stand,
    Unknown,
};
pub use parameters::{Parameter, unit_symbol};
pub use read::ReadFile;
pub use response::{Response, Wanted};
pub use timeline::Approach;
