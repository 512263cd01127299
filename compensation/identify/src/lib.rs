#![doc = include_str!("../README.md")]

mod basis;
mod checks;
mod coefficients;
mod derivatives;
mod equation;
mod error;
mod fit;
mod identify;
mod next;
mod observation_file;
mod observations;
mod parameters;
mod params;
mod rank;
mod row_file;
mod setup_keys;
mod solve;
mod start;
mod system;
mod timeline;

pub use basis::Basis;
pub use checks::standard_uncertainty_um;
pub use error::{FarFile, IdentifyError};
pub use identify::{
    Figures, FileResiduals, Identification, LeftOut, MachineSampler, identify, identify_followed,
    machine_with,
};
pub use next::Next;
pub use observations::{
    Kind, MachinePose, NumberKind, Observation, Observations, Quantity, Row, RowReading,
    SecondAxis, SetUp, Unknown,
};
pub use parameters::{Response, SupportedShare, UndeterminedError};
pub use params::{Parameter, unit_symbol};
pub use setup_keys::ReadFile;
pub use system::Follower;
pub use timeline::Approach;
