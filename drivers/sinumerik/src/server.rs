//! How the OPC UA server of a control is reached.

use std::{fmt, path::PathBuf, time::Duration};

use volcomp_port::Backoff;

use crate::error::SinumerikError;

/// The server of an 840D sl or 828D samples no faster than this, and subscriptions publish no faster.
pub const SHORTEST_PERIOD: Duration = Duration::from_millis(100);
/// The port of the control's OPC UA server as delivered.
pub const PORT: u16 = 4840;

/// The server of a control, and how it is asked.
#[derive(Clone, Debug, PartialEq)]
pub struct Server {
    /// Its URL, `opc.tcp://HOST:4840`.
    pub url: String,
    /// The namespace of its nodes. Its index is looked up in the server's NamespaceArray at every connection.
    pub namespace: String,
    /// Who logs in; `None`: anonymous.
    pub user: Option<User>,
    /// How messages are protected.
    pub security: Security,
    /// The folder with certificates: `own/cert.der`, `private/private.pem`, `trusted/` with the server's. Needed where
    /// messages are protected.
    pub pki: Option<PathBuf>,
    /// The time from one reading to the next.
    pub period: Duration,
    /// How long a request may take; the session is given up after that.
    pub time_out: Duration,
    /// Whether the server's source timestamps make positions older than the exchange. A server that moves them on only
    /// when a value changes makes every axis stale that stands still: then this must be off.
    pub source_timestamps: bool,
    /// The time between two tries to connect.
    pub backoff: Backoff,
}

/// A user name and its password.
#[derive(Clone, PartialEq, Eq)]
pub struct User {
    /// The name.
    pub name: String,
    /// The password, which no message and no `Debug` shows.
    pub password: String,
}

impl fmt::Debug for User {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("User")
            .field("name", &self.name)
            .finish_non_exhaustive()
    }
}

/// How messages are protected, with the policy Basic256Sha256.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Security {
    /// Not at all: a password travels in the clear.
    #[default]
    None,
    /// They are signed.
    Sign,
    /// They are signed and encrypted.
    SignAndEncrypt,
}

impl Server {
    /// The server of this URL: namespace `SinumerikVarProvider`, anonymous, not protected, a reading every 100 ms, requests
    /// answered within 500 ms.
    pub fn new(url: impl Into<String>) -> Self {
        Self {
            url: url.into(),
            namespace: "SinumerikVarProvider".to_owned(),
            user: None,
            security: Security::None,
            pki: None,
            period: SHORTEST_PERIOD,
            time_out: Duration::from_millis(500),
            source_timestamps: true,
            backoff: Backoff::default(),
        }
    }

    /// Checks period, time-out and certificates, without connecting.
    ///
    /// # Errors
    /// The first that is wrong.
    pub fn check(&self) -> Result<(), SinumerikError> {
        if self.period < SHORTEST_PERIOD {
            return Err(SinumerikError::Period(self.period));
        }
        if !(Duration::from_millis(10)..=Duration::from_secs(60)).contains(&self.time_out) {
            return Err(SinumerikError::TimeOut(self.time_out));
        }
        if self.security != Security::None && self.pki.is_none() {
            return Err(SinumerikError::NoCertificates);
        }
        Ok(())
    }

    /// How long after a correction was sent it shows in a reading at the latest, where everything is answered in time: the
    /// write, a reading that had begun before, and the next one.
    pub fn read_back(&self) -> Duration {
        self.time_out + 2 * self.period
    }
}
