//! Circular tests: the deviations of ISO 230-4 from a ballbar trace or from positions, and the machine errors that the
//! trace indicates.
//!
//! A trace has the radial deviation over the angle of a circle in the plane of two linear axes. The centre of the
//! least-squares circle is removed, because it depends on the set-up of the ballbar or the circle instead of the
//! machine.

mod deviations;
mod signatures;
mod table;
mod trace;

pub use deviations::{CircularDeviations, circular_deviations};
pub use signatures::{Signature, SignatureKind, Signatures, circular_signatures};
pub(crate) use table::looks_like_circle;
pub use table::parse_trace;
pub use trace::{CircularPlane, CircularTrace, Sense, TracePoint};

/// Maximum radius of a circular test, mm.
pub const LARGEST_RADIUS_MM: f64 = 100_000.0;
