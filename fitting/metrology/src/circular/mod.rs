//! Circular tests: the deviations of ISO 230-4 from a trace of a ballbar or of positions, and what in the machine they hint at.
//!
//! A trace holds the radial deviation over the angle of a circle that two linear axes make together. The centre of the
//! least-squares circle is taken out: where the ballbar or the circle was set up says nothing about the machine.

mod deviations;
mod signatures;
mod table;
mod trace;

pub use deviations::{CircularDeviations, circular_deviations};
pub use signatures::{Signature, SignatureKind, Signatures, circular_signatures};
pub(crate) use table::looks_like_circle;
pub use table::parse_trace;
pub use trace::{CircularPlane, CircularTrace, Sense, TracePoint};

/// The largest radius, mm.
pub const LARGEST_RADIUS_MM: f64 = 100_000.0;
