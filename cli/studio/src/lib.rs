#![doc = include_str!("../README.md")]

mod error;
mod fit;
mod folder;
mod http;
mod outputs;
mod questions;
mod send;
mod undo;

pub use error::StudioError;
pub use fit::{ErrorChange, FitResult, ModelDrift, Verdict};
pub use folder::{EarlierModel, FileState, Folder, MAX_FILE_BYTES, MAX_FILES, MachineState, State};
pub use http::Studio;
pub use outputs::{AxisResidual, NcProgram, TableFiles, TableRequest};
pub use questions::{DraftQuestion, DraftState, TypedAnswer};
pub use send::{Delivery, Target};
