//! The barrier: the control's half of the protection, as a reference that a control's program can be held against.
//!
//! By the rules of the [protocol](crate::protocol) the control decides for itself which [`Frame`] it takes, moves what it
//! applies at its own rate, and goes to zero by itself when no frame comes any more. What it does is published in a [`Report`];
//! a gateway believes a correction only when a report says that it is applied. Values are whole counts: one count is the
//! smallest step of the axis.

mod control;
mod digital_lines;
mod frame;
#[cfg(feature = "simulate")]
mod program;
mod report;
mod settings;

pub use control::{Barrier, MAILBOXES, Memory};
pub use digital_lines::DigitalLines;
pub use frame::{FRAME_WORDS, Frame};
#[cfg(feature = "simulate")]
pub use program::{Program, Protection};
pub use report::{REPORT_WORDS, Report};
pub use settings::{LARGEST_MACHINE, Settings, SettingsError};
