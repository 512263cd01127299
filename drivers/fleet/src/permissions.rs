//! Who may do what at the NATS server: one place for the permissions, and the text of the server's configuration.
//!
//! A machine publishes on its own four subjects and reads its own key and its own object store. It cannot list, watch or
//! delete anything, and hears nothing of another machine: the inboxes on which it is answered carry its name.

use std::{
    collections::BTreeSet,
    fmt::{self, Write},
    path::PathBuf,
};

use sha2::{Digest, Sha256};

use crate::{
    Identity, Subjects,
    manifest::hex,
    subjects::{latest_desired_subject, models_bucket},
};

/// The largest message, bytes: a model of one MiB with its manifest, as JSON.
const MAX_PAYLOAD: usize = 4 * 1024 * 1024;

/// The subjects on which a user may publish, and to which it may subscribe.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Permissions {
    pub publish: Vec<String>,
    pub subscribe: Vec<String>,
}

impl Permissions {
    pub fn of_machine(identity: &Identity) -> Self {
        let subjects = Subjects::of(identity);
        let models = models_bucket(&identity.machine);
        Self {
            publish: vec![
                subjects.condition,
                subjects.telemetry,
                subjects.audit,
                subjects.ack,
                // The latest value of its own key, and nothing else of that stream.
                latest_desired_subject(&identity.machine),
                // Its own object store, message by message. No consumer: it would have messages sent to any subject.
                format!("$JS.API.DIRECT.GET.OBJ_{models}.>"),
                format!("$JS.API.DIRECT.GET.OBJ_{models}"),
            ],
            subscribe: vec![subjects.desired, format!("{}.>", subjects.inbox)],
        }
    }

    /// What a centre may: everything of the fleet.
    pub fn of_centre() -> Self {
        let everything = || vec![">".to_owned()];
        Self {
            publish: everything(),
            subscribe: everything(),
        }
    }
}

/// A machine with the key of its user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MachineUser {
    pub identity: Identity,
    /// The public nkey of its user, `U…`.
    pub nkey: String,
}

/// The server's files for TLS.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerTls {
    pub certificate: PathBuf,
    pub key: PathBuf,
}

/// The settings of a NATS server.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerSettings {
    /// The name of the server, one in its cluster.
    pub name: String,
    /// The address on which clients reach it.
    pub listen: String,
    pub store: PathBuf,
    /// TLS towards clients; `None`: in the clear, which is for a computer alone.
    pub tls: Option<ServerTls>,
    pub cluster: Option<Cluster>,
    pub centres: Vec<String>,
    pub machines: Vec<MachineUser>,
}

/// Why settings make no configuration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NoConfiguration {
    /// A text would break out of its quotation marks.
    #[error(
        "{what}: found {found:?}, expected a text without quotation marks, backslashes and control characters"
    )]
    Text { what: &'static str, found: String },
    /// An address of a server of the cluster that is none, or that has a password of its own.
    #[error("routes: found {found}, expected nats://HOST:PORT without a user")]
    Route { found: String },
    /// A key that is no public nkey of a user.
    #[error(
        "found the key {found:?}, expected the public nkey of a user: U and 55 letters and digits"
    )]
    Nkey { found: String },
    /// One key for two users: the server could not tell them apart.
    #[error("the key {found} stands for two users, expected one of its own for each")]
    Twice { found: String },
}

impl ServerSettings {
    /// The text of the configuration file of the server. **Of a server in a cluster it holds the password of the cluster**, and
    /// belongs into a file that only its owner reads.
    ///
    /// # Errors
    /// A text or a key that cannot stand in it.
    pub fn text(&self) -> Result<String, NoConfiguration> {
        let store = self.store.display().to_string();
        let mut text = String::new();
        // Writing to a string never fails.
        let _ = write!(
            text,
            "server_name: {}\nlisten: {}\nmax_payload: {MAX_PAYLOAD}\njetstream {{ store_dir: {} }}\n",
            quoted("name", &self.name)?,
            quoted("listen", &self.listen)?,
            quoted("store", &store)?,
        );
        if let Some(tls) = &self.tls {
            let _ = writeln!(
                text,
                "tls {{ cert_file: {}, key_file: {} }}",
                quoted("certificate", &tls.certificate.display().to_string())?,
                quoted("key", &tls.key.display().to_string())?
            );
        }
        if let Some(cluster) = &self.cluster {
            text.push_str(&cluster.text(self.tls.as_ref())?);
        }
        text.push_str("authorization {\n  users: [\n");
        let mut seen = BTreeSet::new();
        let centres = (self.centres.iter()).map(|nkey| (nkey, Permissions::of_centre()));
        let machines = (self.machines.iter())
            .map(|user| (&user.nkey, Permissions::of_machine(&user.identity)));
        for (nkey, permissions) in centres.chain(machines) {
            check_nkey(nkey)?;
            if !seen.insert(nkey) {
                return Err(NoConfiguration::Twice {
                    found: nkey.clone(),
                });
            }
            user(&mut text, nkey, &permissions);
        }
        text.push_str("  ]\n}\n");
        Ok(text)
    }
}

fn user(text: &mut String, nkey: &str, permissions: &Permissions) {
    let list = |subjects: &[String]| {
        let subjects: Vec<String> = subjects.iter().map(|one| format!("\"{one}\"")).collect();
        subjects.join(", ")
    };
    let _ = writeln!(
        text,
        "    {{ nkey: {nkey}, permissions: {{ publish: [{}], subscribe: [{}] }} }}",
        list(&permissions.publish),
        list(&permissions.subscribe)
    );
}

/// Whether a text has the form of the public nkey of a user: U and 55 letters and digits of base 32.
pub fn is_public_nkey(text: &str) -> bool {
    text.len() == 56
        && text.starts_with('U')
        && text
            .bytes()
            .all(|byte| byte.is_ascii_uppercase() || (b'2'..=b'7').contains(&byte))
}

fn check_nkey(nkey: &str) -> Result<(), NoConfiguration> {
    if is_public_nkey(nkey) {
        Ok(())
    } else {
        Err(NoConfiguration::Nkey {
            found: nkey.to_owned(),
        })
    }
}

fn quoted(what: &'static str, text: &str) -> Result<String, NoConfiguration> {
    let breaks_out = |c: char| c == '"' || c == '\\' || c.is_control();
    if text.contains(breaks_out) {
        return Err(NoConfiguration::Text {
            what,
            found: text.to_owned(),
        });
    }
    Ok(format!("\"{text}\""))
}

/// What stands before the seed in the bytes whose hash is the password, so that it is the hash of nothing else.
const PURPOSE: &[u8] = b"volcomp route 1\0";
/// The user as which a server joins.
const USER: &str = "route";

/// The password by which the servers of a cluster know one another. No `Debug` shows it.
#[derive(Clone, PartialEq, Eq)]
pub struct RoutePassword(String);

impl fmt::Debug for RoutePassword {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RoutePassword")
    }
}

impl RoutePassword {
    /// The password that belongs to the seed of a centre's nkey: the same for every server whose configuration that centre
    /// writes. The seed cannot be found from it.
    pub fn of_seed(seed: &str) -> Self {
        let bytes = [PURPOSE, seed.trim().as_bytes()].concat();
        Self(hex(&Sha256::digest(bytes)))
    }
}

/// A server among the others of its cluster. Whoever joins there reads and writes everything, so it asks for a password, and for
/// certificates where the servers have them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cluster {
    pub name: String,
    /// The address on which the other servers reach this one.
    pub listen: String,
    /// The addresses of the servers of the cluster, `nats://HOST:PORT`.
    pub routes: Vec<String>,
    pub password: RoutePassword,
    /// Certificates by which they know one another's, PEM; `None`: those of the system. Used where the server has TLS.
    pub roots: Option<PathBuf>,
}

impl Cluster {
    /// The table of the server's configuration, with a line end.
    fn text(&self, tls: Option<&ServerTls>) -> Result<String, NoConfiguration> {
        let password = &self.password.0;
        let routes: Result<Vec<String>, NoConfiguration> = (self.routes.iter())
            .map(|route| quoted("routes", &self.with_password(route)?))
            .collect();
        let mut text = String::new();
        // Writing to a string never fails.
        let _ = writeln!(
            text,
            "cluster {{\n  name: {}\n  listen: {}\n  routes: [{}]\n  authorization {{ user: {USER}, password: \"{password}\", timeout: 5 }}",
            quoted("cluster", &self.name)?,
            quoted("cluster_listen", &self.listen)?,
            routes?.join(", ")
        );
        if let Some(tls) = tls {
            let path = |what, file: &PathBuf| quoted(what, &file.display().to_string());
            let _ = write!(
                text,
                "  tls {{ cert_file: {}, key_file: {}, ",
                path("certificate", &tls.certificate)?,
                path("key", &tls.key)?
            );
            if let Some(roots) = &self.roots {
                let _ = write!(text, "ca_file: {}, ", path("ca", roots)?);
            }
            text.push_str("verify: true, timeout: 5 }\n");
        }
        text.push_str("}\n");
        Ok(text)
    }

    /// The address of a server with the password by which it lets another join.
    fn with_password(&self, route: &str) -> Result<String, NoConfiguration> {
        match route.strip_prefix("nats://") {
            Some(address) if !address.is_empty() && !address.contains(['@', '/']) => {
                Ok(format!("nats://{USER}:{}@{address}", self.password.0))
            }
            // One with a password of somebody else's is not repeated in a message.
            Some(address) if address.contains('@') => Err(NoConfiguration::Route {
                found: "an address with a user".to_owned(),
            }),
            _ => Err(NoConfiguration::Route {
                found: format!("{route:?}"),
            }),
        }
    }
}
