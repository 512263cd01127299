#![doc = include_str!("../README.md")]

mod ball_row;
mod basis;
mod checks;
mod coefficients;
mod derivatives;
mod equation;
mod error;
mod fit;
mod fold;
mod found_machine;
mod identify;
mod next;
mod observation_file;
mod observations;
mod parameters;
mod params;
mod penalty;
mod rank;
mod response;
mod row_file;
mod sampler;
mod setup_keys;
mod sides;
mod solve;
mod start;
mod system;
mod timeline;
mod triangle;

pub use basis::Basis;
pub use checks::input::standard_uncertainty_um;
pub use error::{FarFile, IdentifyError};
pub use found_machine::machine_with;
pub use identify::{Figures, FileResiduals, Identification, LeftOut, identify, identify_followed};
pub use next::Next;
pub use observations::{
    Kind, MachinePose, NumberKind, Observation, Observations, Quantity, Row, RowReading,
    SecondAxis, SetUp, Unknown,
};
pub use parameters::UndeterminedError;
pub use params::{Parameter, unit_symbol};
pub use response::{Response, SupportedShare};
pub use sampler::MachineSampler;
pub use setup_keys::ReadFile;
pub use system::Follower;
pub use timeline::Approach;
