#![doc = include_str!("../README.md")]

mod ball_row;
mod basis;
mod checks;
mod coefficients;
mod columns;
mod derivatives;
mod draws;
mod equation;
mod error;
mod fit;
mod found_machine;
mod identify;
mod next;
mod observations;
mod parameters;
mod params;
mod penalty;
mod rank;
mod read;
mod response;
mod rows;
mod setup_keys;
mod sides;
mod solve;
mod start;
mod system;
mod timeline;
mod unknown_file;

pub use basis::Basis;
pub use checks::input::standard_uncertainty_um;
pub use draws::Draws;
pub use error::{FarFile, IdentifyError};
pub use found_machine::machine_with;
pub use identify::{Figures, Identification, LeftOut, identify, identify_followed};
pub use next::Next;
pub use observations::{
    Kind, NumberKind, Observation, Observations, Quantity, Row, SecondAxis, Seen, SetUp, Stand,
    Unknown,
};
pub use parameters::LeftOpen;
pub use params::{Parameter, unit_symbol};
pub use response::{Response, Wanted};
pub use setup_keys::ReadFile;
pub use system::Follower;
pub use timeline::Approach;
