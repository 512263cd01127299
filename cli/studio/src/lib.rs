#![doc = include_str!("../README.md")]

mod error;
mod fit;
mod folder;
mod http;
mod outputs;
mod questions;
mod send;
mod uploads;

pub use error::StudioError;
pub use fit::{Fitted, Verdict};
pub use folder::{FileSeen, Folder, MachineSeen, State};
pub use http::Studio;
pub use outputs::{AxisLeft, NcDone, NcNote, TableRequest, TablesDone};
pub use questions::{DraftSeen, GivenAnswer, QuestionAsked};
pub use send::{Sent, Target};
pub use uploads::{LARGEST_FILE, MAX_FILES};
