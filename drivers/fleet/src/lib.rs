#![doc = include_str!("../README.md")]

mod accept;
mod address;
mod cluster;
#[cfg(feature = "nats")]
mod collect;
#[cfg(feature = "nats")]
mod hub;
mod identity;
#[cfg(feature = "nats")]
mod link;
mod manifest;
mod permissions;
mod report;
#[cfg(feature = "server")]
pub mod server;
mod spool;
mod spool_file;
#[cfg(feature = "nats")]
mod streams;
mod subjects;

pub use accept::{Accepted, NotAccepted, Trust};
pub use address::{ADDRESSES, addresses, in_the_clear, wrong_address};
pub use cluster::{Cluster, RoutePassword};
#[cfg(feature = "nats")]
pub use collect::{Batch, Collection, Received};
#[cfg(feature = "nats")]
pub use hub::{DesiredWatch, Found, Heard, Hub};
pub use identity::{Identity, MachineId, SiteId, UnknownId};
#[cfg(feature = "nats")]
pub use link::{LinkError, LinkSettings, MachineLink, MachineSender};
pub use manifest::{
    Desired, INLINE_LIMIT, Manifest, ModelRef, NotADesired, SigningKey, VerifyingKey, trusted_key,
};
pub use permissions::{
    MAX_PAYLOAD, MachineUser, NoConfiguration, Permissions, ServerSettings, ServerTls,
    is_public_nkey,
};
pub use report::{Acknowledgement, AuditLine, Condition, Envelope, Outcome, largest_moves};
pub use spool::{Lane, Spool, SpoolLimits, Waiting};
#[cfg(feature = "nats")]
pub use streams::{Keeping, prepare, put_model};
pub use subjects::{
    AUDIT_PREFIX, DESIRED_BUCKET, Kind, Subjects, TELEMETRY_PREFIX, models_bucket, streams_of,
};
