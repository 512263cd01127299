//! The control's half of the map mode, as a reference that a control's program is held against.
//!
//! By the rules of the [`protocol`](volcomp_guard::protocol) the control alone decides what it takes. A map comes in pieces through one mailbox, in
//! their order, into the buffer that is not in use; a last frame swaps the buffers, and only where the checksum of all
//! that arrived fits. What the axes get moves at a rate of its own, to another map as well as to zero, where it goes when
//! nobody sends any more.
//!
//! Everything is 16-bit words and whole numbers. [`Lookup::scan`] allocates nothing, waits for nothing and reads no clock:
//! the time is the number of scans.

mod frame;
mod lookup;
mod report;
mod settings;
mod travel;

pub use frame::{Body, DATA, FRAME_WORDS, Frame};
pub use lookup::{Lookup, Memory};
pub use report::{REPORT_WORDS, Report};
pub use settings::{Settings, SettingsError};
