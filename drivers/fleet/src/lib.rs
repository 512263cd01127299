#![doc = include_str!("../README.md")]

mod address;
#[cfg(feature = "nats")]
mod hub;
#[cfg(feature = "nats")]
mod link;
mod manifest;
mod permissions;
mod report;
#[cfg(feature = "server")]
pub mod server;
mod spool;
mod subjects;

pub use address::{ADDRESSES, addresses, first_port, in_the_clear, wrong_address};
#[cfg(feature = "nats")]
pub use hub::{
    Batch, Collection, DesiredEvent, DesiredValue, DesiredWatch, Hub, Received, StreamRetention,
    prepare, put_model,
};
#[cfg(feature = "nats")]
pub use link::{LinkError, LinkSettings, MachineLink, MachineSender};
pub use manifest::{
    Accepted, Desired, DesiredError, INLINE_LIMIT, Manifest, ManifestRejection, ModelRef,
    SigningKey, Trust, VerifyingKey, trusted_key,
};
pub use permissions::{
    Cluster, MachineUser, Permissions, RoutePassword, ServerConfigError, ServerSettings, ServerTls,
    is_public_nkey,
};
pub use report::{Acknowledgement, AuditLine, Condition, Envelope, Outcome, largest_moves};
pub use spool::{Lane, Spool, SpoolLimits, Waiting};
pub use subjects::{IdError, Identity, Kind, MachineId, SiteId, Subjects};
