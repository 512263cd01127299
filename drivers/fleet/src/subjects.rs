//! Names in the fleet: machines and their sites, subjects, buckets and streams.
//!
//! A machine publishes on its own four subjects, one for each [`Kind`] of message, and reads only its own key.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

/// Key-value bucket of the desired states. The key of a machine is its name.
pub(crate) const DESIRED_BUCKET: &str = "desired";

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    Ack,
    Audit,
    Condition,
    Telemetry,
}

impl Kind {
    pub const ALL: [Self; 4] = [Self::Ack, Self::Audit, Self::Condition, Self::Telemetry];

    /// Last token of the subject of this kind.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ack => "ack",
            Self::Audit => "audit",
            Self::Condition => "condition",
            Self::Telemetry => "telemetry",
        }
    }

    /// Kind whose subject ends with this token; `None` for other tokens.
    pub fn with_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }
}

/// Subject of a machine's key in the bucket of desired states. A wildcard selects every machine.
pub(crate) fn desired_subject(machine: &str) -> String {
    format!("$KV.{DESIRED_BUCKET}.{machine}")
}

/// Subject of the direct request for the latest value of a machine's key.
pub(crate) fn latest_desired_subject(machine: &MachineId) -> String {
    let desired = desired_subject(machine.as_str());
    format!("$JS.API.DIRECT.GET.KV_{DESIRED_BUCKET}.{desired}")
}

/// Name of the object store with a machine's models that are too large for a manifest.
pub(crate) fn models_bucket(machine: &MachineId) -> String {
    format!("models-{machine}")
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Subjects {
    /// Subject of short conditions, once a second by default.
    pub condition: String,
    /// Subject of full telemetry, every ten seconds by default.
    pub telemetry: String,
    pub audit: String,
    pub ack: String,
    pub desired: String,
    /// Prefix of the machine's reply inboxes.
    pub inbox: String,
}

impl Subjects {
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

    pub fn of_kind(&self, kind: Kind) -> &str {
        match kind {
            Kind::Ack => &self.ack,
            Kind::Audit => &self.audit,
            Kind::Condition => &self.condition,
            Kind::Telemetry => &self.telemetry,
        }
    }
}

const MAX_ID_BYTES: usize = 64;

/// A name that is invalid as a token of a NATS subject.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "found {found:?}, expected 1 to 64 lower-case letters, digits and hyphens, a letter or a digit first"
)]
pub struct IdError {
    pub found: String,
}

fn check(text: &str) -> Result<(), IdError> {
    let first = text.bytes().next();
    let fits = first.is_some_and(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit())
        && text.len() <= MAX_ID_BYTES
        && text
            .bytes()
            .all(|byte| byte.is_ascii_lowercase() || byte.is_ascii_digit() || byte == b'-');
    if fits { Ok(()) } else { Err(IdError { found: text.to_owned() }) }
}

macro_rules! id {
    ($name:ident, $what:literal) => {
        #[doc = $what]
        #[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[serde(try_from = "String", into = "String")]
        pub struct $name(String);

        impl $name {
            pub fn as_str(&self) -> &str {
                &self.0
            }
        }

        impl FromStr for $name {
            type Err = IdError;

            fn from_str(text: &str) -> Result<Self, IdError> {
                check(text).map(|()| Self(text.to_owned()))
            }
        }

        impl TryFrom<String> for $name {
            type Error = IdError;

            fn try_from(text: String) -> Result<Self, IdError> {
                check(&text).map(|()| Self(text))
            }
        }

        impl From<$name> for String {
            fn from(name: $name) -> Self {
                name.0
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str(&self.0)
            }
        }
    };
}

id!(
    MachineId,
    "The name of a machine, one in the whole fleet: 1 to 64 lower-case letters, digits and hyphens."
);
id!(SiteId, "The name of a site: 1 to 64 lower-case letters, digits and hyphens.");

#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Identity {
    pub site: SiteId,
    pub machine: MachineId,
}
