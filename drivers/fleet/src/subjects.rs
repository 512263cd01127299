//! The subjects, buckets and streams of the fleet: one place for their names.
//!
//! A machine publishes on its own four subjects and reads the key of its own name, nothing else.

use crate::{Identity, MachineId, SiteId};

/// The key-value bucket that holds what each machine shall run: the key is the name of the machine.
pub const DESIRED_BUCKET: &str = "desired";
/// The stream of conditions and telemetry of a site is this and the name of the site.
pub const TELEMETRY_PREFIX: &str = "telemetry-";
/// The stream of audit records and acknowledgements of a site is this and the name of the site.
pub const AUDIT_PREFIX: &str = "audit-";

/// The object store that holds models of a machine which are too large for a manifest.
pub fn models_bucket(machine: &MachineId) -> String {
    format!("models-{machine}")
}

/// The two streams of a site with the subjects that they hold: telemetry, then audit.
pub fn streams_of(site: &SiteId) -> [(String, Vec<String>); 2] {
    let of = |kinds: [&str; 2]| {
        kinds
            .map(|kind| format!("volcomp.{site}.*.{kind}"))
            .to_vec()
    };
    [
        (
            format!("{TELEMETRY_PREFIX}{site}"),
            of(["condition", "telemetry"]),
        ),
        (format!("{AUDIT_PREFIX}{site}"), of(["audit", "ack"])),
    ]
}

/// The subjects of one machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Subjects {
    /// The short condition, once a second.
    pub condition: String,
    /// The whole state, every ten seconds.
    pub telemetry: String,
    /// Records of the audit log.
    pub audit: String,
    /// Acknowledgements of manifests.
    pub ack: String,
    /// The subject on which a new manifest of this machine appears.
    pub desired: String,
    /// The prefix of the inboxes on which this machine is answered.
    pub inbox: String,
}

impl Subjects {
    /// The subjects of a machine.
    pub fn of(identity: &Identity) -> Self {
        let Identity { site, machine } = identity;
        let own = |kind: &str| format!("volcomp.{site}.{machine}.{kind}");
        Self {
            condition: own("condition"),
            telemetry: own("telemetry"),
            audit: own("audit"),
            ack: own("ack"),
            desired: format!("$KV.{DESIRED_BUCKET}.{machine}"),
            inbox: format!("_INBOX_{machine}"),
        }
    }
}
