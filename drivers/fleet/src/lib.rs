#![doc = include_str!("../README.md")]

mod accept;
mod identity;
mod manifest;
mod report;
mod subjects;

pub use accept::{Accepted, NotAccepted, Trust};
pub use identity::{Identity, MachineId, SiteId, UnknownId};
pub use manifest::{
    Desired, INLINE_LIMIT, Manifest, ModelRef, NotADesired, SigningKey, VerifyingKey,
};
pub use report::{Acknowledgement, Condition, Envelope, Outcome};
pub use subjects::{
    AUDIT_PREFIX, DESIRED_BUCKET, Subjects, TELEMETRY_PREFIX, models_bucket, streams_of,
};
