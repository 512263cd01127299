//! The barrier: the control's half of the protection, as a reference that a control's program can be held against.
//!
//! The wire between a gateway and a control is taken as a black channel, as in IEC 61784-3: frames may be lost, late,
//! doubled, reordered or torn. So the control decides for itself which [`Frame`] it takes, moves what it applies at its
//! own rate, and goes to zero by itself when no frame comes any more. What it does is published in a [`Report`]; a
//! gateway believes a correction only when a report says that it is applied.
//!
//! Everything is 16-bit words and whole counts (one count is the smallest step of the axis), because that is what a
//! controller's own program has. Nothing here allocates, waits or reads a clock: the time is the number of scans.

mod checksum;
mod control;
mod digital_lines;
mod frame;
mod layout;
#[cfg(feature = "simulate")]
mod program;
mod report;
mod session;
mod settings;

pub use checksum::{Checksum, checksum};
pub use control::{Barrier, MAILBOXES, Memory};
pub use digital_lines::DigitalLines;
pub use frame::{FRAME_WORDS, Frame};
pub use layout::Layout;
#[cfg(feature = "simulate")]
pub use program::{Program, Protection};
pub use report::{REPORT_WORDS, Refusal, Report};
pub use session::{Answered, Seen, Session};
pub use settings::{LARGEST_MACHINE, Settings, SettingsError};

/// One value for each axis of a channel, in counts of that axis.
pub type Counts = volcomp_vocabulary::PerChannel<i16>;

/// Whether `later` lies ahead of `earlier` on a counter of 16 bits that wraps around: by less than half of its range.
fn is_ahead(later: u16, earlier: u16) -> bool {
    (1..1 << 15).contains(&later.wrapping_sub(earlier))
}
