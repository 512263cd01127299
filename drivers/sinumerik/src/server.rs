use std::{fmt, path::PathBuf, time::Duration};

use volcomp_port::Backoff;

use crate::error::SinumerikError;

/// Shortest sampling and publishing period of the OPC UA server of an 840D sl or 828D.
pub const SHORTEST_PERIOD: Duration = Duration::from_millis(100);
/// Default port of the control's OPC UA server.
pub const PORT: u16 = 4840;

/// The OPC UA server of a control, and the settings for polling it.
#[derive(Clone, Debug, PartialEq)]
pub struct Server {
    /// URL of the server: `opc.tcp://HOST:4840`.
    pub url: String,
    /// Namespace of the server's nodes. Its index is looked up in the server's NamespaceArray at every connection.
    pub namespace: String,
    /// User that logs in; `None` for an anonymous login.
    pub user: Option<User>,
    pub security: Security,
    /// Folder with certificates: `own/cert.der`, `private/private.pem`, and `trusted/` with the server's certificate.
    /// Required for message security.
    pub pki: Option<PathBuf>,
    pub period: Duration,
    /// Timeout of a request. When it expires, the session is closed.
    pub time_out: Duration,
    /// Whether the age of positions is taken from the server's source timestamps. Set this to `false` if the server
    /// updates a timestamp only when the value changes, because positions at standstill would then seem to be old.
    pub source_timestamps: bool,
    /// Delay between two connection attempts.
    pub backoff: Backoff,
}

#[derive(Clone, PartialEq, Eq)]
pub struct User {
    pub name: String,
    /// Password of the user. It never appears in messages or `Debug` output.
    pub password: String,
}

impl fmt::Debug for User {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("User").field("name", &self.name).finish_non_exhaustive()
    }
}

/// Message security. Signatures and encryption use the policy Basic256Sha256.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Security {
    /// Messages are neither signed nor encrypted, so passwords are sent in clear text.
    #[default]
    None,
    Sign,
    SignAndEncrypt,
}

impl Server {
    /// Creates the settings for a server: namespace `SinumerikVarProvider`, anonymous, no message security, a reading
    /// every 100 ms, a timeout of 500 ms.
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

    /// Checks period, timeout and certificates, without connecting.
    ///
    /// # Errors
    /// The first invalid setting.
    pub fn check(&self) -> Result<(), SinumerikError> {
        if self.period < SHORTEST_PERIOD {
            return Err(SinumerikError::Period { found: self.period, shortest: SHORTEST_PERIOD });
        }
        if !(Duration::from_millis(10)..=Duration::from_secs(60)).contains(&self.time_out) {
            return Err(SinumerikError::TimeOut(self.time_out));
        }
        if self.security != Security::None && self.pki.is_none() {
            return Err(SinumerikError::NoCertificates);
        }
        Ok(())
    }

    /// Maximum time until a sent correction appears in a reading, if every request is answered in time. The time
    /// consists of the write, a reading that has already begun, and the next reading.
    pub fn read_back(&self) -> Duration {
        self.time_out + 2 * self.period
    }
}
