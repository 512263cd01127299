//! Identity of a machine in the fleet: its site and its name, as used in subjects, keys and manifests.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

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
