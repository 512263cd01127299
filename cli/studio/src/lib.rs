#![doc = include_str!("../README.md")]

mod error;
mod fit;
mod folder;
mod http;
mod outputs;
mod questions;
mod send;

pub use error::StudioError;
pub use fit::{Fitted, Verdict};
pub use folder::{FileSeen, Folder, LARGEST_FILE, MAX_FILES, MachineSeen, State};
pub use http::Studio;
pub use outputs::{AxisLeft, NcDone, NcNote, TableRequest, TablesDone};
pub use questions::{DraftSeen, GivenAnswer, QuestionAsked};
pub use send::{Sent, Target};
