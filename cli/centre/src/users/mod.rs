//! Users: roles, passwords and sessions, as plain data and rules. `store::users` stores them.

mod password;
mod session;
mod throttle;

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

use crate::Error;
pub use password::{Password, hash, is_right};
pub use session::{Moment, Session, Token};
pub use throttle::{Attempt, Throttle};
pub(crate) use throttle::{REFUSAL_WINDOW, Refusal, Refusals};

/// Permissions of a user; each role includes those before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Role {
    /// Read only.
    Viewer,
    /// May register machines, add models, roll them out, acknowledge alarms and search the network.
    Engineer,
    /// May manage users and read the audit log.
    Admin,
}

impl Role {
    pub const ALL: [Self; 3] = [Self::Viewer, Self::Engineer, Self::Admin];

    /// Name in JSON and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Viewer => "viewer",
            Self::Engineer => "engineer",
            Self::Admin => "admin",
        }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Role {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL
            .into_iter()
            .find(|role| role.name() == text)
            .ok_or_else(|| format!("found {text:?}, expected viewer, engineer or admin"))
    }
}

/// User name, unique in the centre: 1 to 64 lower-case letters, digits, dots, hyphens and underscores.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct UserName(String);

impl UserName {
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl FromStr for UserName {
    type Err = Error;

    fn from_str(text: &str) -> Result<Self, Error> {
        let fits =
            |byte: u8| byte.is_ascii_lowercase() || byte.is_ascii_digit() || b".-_".contains(&byte);
        let first = text
            .bytes()
            .next()
            .is_some_and(|byte| byte.is_ascii_lowercase());
        // In the audit log, `centre` denotes the program itself.
        if first && text.len() <= 64 && text.bytes().all(fits) && text != "centre" {
            Ok(Self(text.to_owned()))
        } else {
            let found: String = text.chars().take(80).collect();
            Err(Error::Wrong(format!(
                "found {found:?}, expected a user's name: 1 to 64 lower-case letters, digits, dots, hyphens and underscores, a letter first; not `centre`"
            )))
        }
    }
}

impl TryFrom<String> for UserName {
    type Error = Error;

    fn try_from(text: String) -> Result<Self, Error> {
        text.parse()
    }
}

impl From<UserName> for String {
    fn from(name: UserName) -> Self {
        name.0
    }
}

impl fmt::Display for UserName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A user, without the password.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct User {
    pub name: UserName,
    pub role: Role,
    pub disabled: bool,
    pub added_s: f64,
    pub added_by: String,
}
