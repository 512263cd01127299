//! The subjects, buckets and streams of the fleet: one place for their names.
//!
//! A machine publishes on its own four subjects, one for each [`Kind`] of message, and reads the key of its own name, nothing
//! else.

use crate::{Identity, MachineId, SiteId};

/// The key-value bucket that holds what each machine shall run: the key is the name of the machine.
pub(crate) const DESIRED_BUCKET: &str = "desired";
/// The stream of conditions and telemetry of a site is this and the name of the site.
const TELEMETRY_PREFIX: &str = "telemetry-";
/// The stream of audit records and acknowledgements of a site is this and the name of the site.
pub(crate) const AUDIT_PREFIX: &str = "audit-";

/// The kind of a message of a machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Ack,
    Audit,
    Condition,
    Telemetry,
}

impl Kind {
    pub const ALL: [Self; 4] = [Self::Ack, Self::Audit, Self::Condition, Self::Telemetry];

    /// The last part of its subject.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ack => "ack",
            Self::Audit => "audit",
            Self::Condition => "condition",
            Self::Telemetry => "telemetry",
        }
    }

    /// The kind with this last part of its subject.
    pub fn with_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// The subject on which the values of the key of a machine appear; with a wildcard in its place those of every machine.
pub(crate) fn desired_subject(machine: &str) -> String {
    format!("$KV.{DESIRED_BUCKET}.{machine}")
}

/// The subject of the direct question for the latest value of the key of a machine.
pub(crate) fn latest_desired_subject(machine: &MachineId) -> String {
    let desired = desired_subject(machine.as_str());
    format!("$JS.API.DIRECT.GET.KV_{DESIRED_BUCKET}.{desired}")
}

/// The object store that holds models of a machine which are too large for a manifest.
pub(crate) fn models_bucket(machine: &MachineId) -> String {
    format!("models-{machine}")
}

/// The two streams of a site with the subjects that they hold: telemetry, then audit.
pub(crate) fn streams_of(site: &SiteId) -> [(String, Vec<String>); 2] {
    let of = |kinds: [Kind; 2]| {
        kinds
            .map(|kind| format!("volcomp.{site}.*.{}", kind.name()))
            .to_vec()
    };
    [
        (
            format!("{TELEMETRY_PREFIX}{site}"),
            of([Kind::Condition, Kind::Telemetry]),
        ),
        (
            format!("{AUDIT_PREFIX}{site}"),
            of([Kind::Audit, Kind::Ack]),
        ),
    ]
}

/// The subjects of one machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Subjects {
    /// The short condition, once a second unless the manifest says otherwise.
    pub condition: String,
    /// The whole state, every ten seconds unless the manifest says otherwise.
    pub telemetry: String,
    pub audit: String,
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
        let own = |kind: Kind| format!("volcomp.{site}.{machine}.{}", kind.name());
        Self {
            condition: own(Kind::Condition),
            telemetry: own(Kind::Telemetry),
            audit: own(Kind::Audit),
            ack: own(Kind::Ack),
            desired: desired_subject(machine.as_str()),
            inbox: format!("_INBOX_{machine}"),
        }
    }

    /// The subject of messages of this kind.
    pub fn of_kind(&self, kind: Kind) -> &str {
        match kind {
            Kind::Ack => &self.ack,
            Kind::Audit => &self.audit,
            Kind::Condition => &self.condition,
            Kind::Telemetry => &self.telemetry,
        }
    }
}
