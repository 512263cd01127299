#![doc = include_str!("../README.md")]

mod ball_row;
mod basis;
mod candidates;
mod causes;
mod changed;
mod checked;
mod coefficients;
mod columns;
mod derivatives;
mod design;
mod doubts;
mod draws;
mod effects;
mod equation;
mod error;
mod followers;
mod identify;
mod judge;
mod kept_curves;
mod left;
mod mistaken;
mod next;
mod observations;
mod order;
mod params;
mod penalty;
mod plausible;
mod prepared;
mod products;
mod rank;
mod read;
mod response;
mod rows;
mod seen_columns;
mod setup_keys;
mod shifted;
mod sight;
mod solve;
mod span;
mod start;
mod system;
mod thin;
mod timeline;
mod units;
mod unknown_file;
mod values;

pub use basis::Basis;
pub use checked::standard_uncertainty_um;
pub use draws::Draws;
pub use error::{Cause, FarFile, IdentifyError};
pub use followers::Follower;
pub use identify::{Identification, Parameter, identify, identify_followed, machine_with};
pub use judge::Figures;
pub use next::Next;
pub use observations::{
    Kind, NumberKind, Observation, Observations, Quantity, Row, SecondAxis, Seen, SetUp, Stand,
    Unknown,
};
pub use read::ReadFile;
pub use response::{Response, Wanted};
pub use timeline::Approach;
