//! Permissions of all users at the NATS server, and the text of the server's configuration.
//!
//! A machine publishes on its own four subjects, and reads its own key and object store. It cannot list, watch or
//! delete anything. It receives no messages of other machines, because the subjects of its inboxes contain its own
//! name.

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

/// Maximum message size, bytes. It suffices for a model of 1 MiB with its manifest, as JSON.
const MAX_PAYLOAD: usize = 4 * 1024 * 1024;

/// Subjects that a user may publish on and subscribe to.
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
                // Requests only the latest value of its key in that stream.
                latest_desired_subject(&identity.machine),
                // Reads the machine's own object store message by message. A consumer is not permitted, because it
                // could send messages to any subject.
                format!("$JS.API.DIRECT.GET.OBJ_{models}.>"),
                format!("$JS.API.DIRECT.GET.OBJ_{models}"),
            ],
            subscribe: vec![subjects.desired, format!("{}.>", subjects.inbox)],
        }
    }

    /// Permissions of a centre: all subjects.
    pub fn of_centre() -> Self {
        let everything = || vec![">".to_owned()];
        Self { publish: everything(), subscribe: everything() }
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MachineUser {
    pub identity: Identity,
    /// Public nkey of the machine, `U…`.
    pub nkey: String,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerTls {
    pub certificate: PathBuf,
    pub key: PathBuf,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ServerSettings {
    /// Name of the server, unique in its cluster.
    pub name: String,
    pub listen: String,
    pub store: PathBuf,
    /// TLS for clients; `None`: unencrypted connections, which are acceptable only within a single computer.
    pub tls: Option<ServerTls>,
    pub cluster: Option<Cluster>,
    pub centres: Vec<String>,
    pub machines: Vec<MachineUser>,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ServerConfigError {
    #[error(
        "{what}: found {found:?}, expected a text without quotation marks, backslashes and control characters"
    )]
    Text { what: &'static str, found: String },
    /// An address of the cluster is invalid or contains a password.
    #[error("routes: found {found}, expected nats://HOST:PORT without a user")]
    Route { found: String },
    #[error(
        "found the key {found:?}, expected the public nkey of a user: U and 55 letters and digits"
    )]
    Nkey { found: String },
    /// Two users have the same key, so the server cannot distinguish them.
    #[error("the key {found} is used for two users, expected a separate key for each")]
    Twice { found: String },
}

impl ServerSettings {
    /// Text of the server's configuration file. **If the server is in a cluster, the text contains the cluster
    /// password**: only the owner of the file may read it.
    ///
    /// # Errors
    /// A text or a key that the configuration cannot represent.
    pub fn text(&self) -> Result<String, ServerConfigError> {
        let store = self.store.display().to_string();
        let mut text = String::new();
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
                return Err(ServerConfigError::Twice { found: nkey.clone() });
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

/// Whether a text has the form of a user's public nkey: U and 55 letters and digits of base 32.
pub fn is_public_nkey(text: &str) -> bool {
    text.len() == 56
        && text.starts_with('U')
        && text.bytes().all(|byte| byte.is_ascii_uppercase() || (b'2'..=b'7').contains(&byte))
}

fn check_nkey(nkey: &str) -> Result<(), ServerConfigError> {
    if is_public_nkey(nkey) {
        Ok(())
    } else {
        Err(ServerConfigError::Nkey { found: nkey.to_owned() })
    }
}

fn quoted(what: &'static str, text: &str) -> Result<String, ServerConfigError> {
    let breaks_out = |c: char| c == '"' || c == '\\' || c.is_control();
    if text.contains(breaks_out) {
        return Err(ServerConfigError::Text { what, found: text.to_owned() });
    }
    Ok(format!("\"{text}\""))
}

/// Prefix of the seed before hashing. It makes the password differ from other hashes of the seed.
const PURPOSE: &[u8] = b"volcomp route 1\0";
/// User name of the servers that join the cluster.
const USER: &str = "route";

/// Password shared by the servers of a cluster. `Debug` does not show it.
#[derive(Clone, PartialEq, Eq)]
pub struct RoutePassword(String);

impl fmt::Debug for RoutePassword {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RoutePassword")
    }
}

impl RoutePassword {
    /// Derives the password from the seed of a centre's nkey, so that all servers configured by that centre share the
    /// password. The seed cannot be recovered from the password.
    pub fn of_seed(seed: &str) -> Self {
        let bytes = [PURPOSE, seed.trim().as_bytes()].concat();
        Self(hex(&Sha256::digest(bytes)))
    }
}

/// Membership of a server in a cluster. A server that joins can read and write everything, so joining requires a
/// password and, if the servers use TLS, certificates.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cluster {
    pub name: String,
    pub listen: String,
    /// Addresses of the servers of the cluster, `nats://HOST:PORT`.
    pub routes: Vec<String>,
    pub password: RoutePassword,
    /// PEM file with the certificates that the servers of the cluster trust; `None`: the certificates of the system.
    /// Unused without TLS.
    pub roots: Option<PathBuf>,
}

impl Cluster {
    /// Table `cluster` of the server's configuration.
    fn text(&self, tls: Option<&ServerTls>) -> Result<String, ServerConfigError> {
        let password = &self.password.0;
        let routes: Result<Vec<String>, ServerConfigError> = (self.routes.iter())
            .map(|route| quoted("routes", &self.with_password(route)?))
            .collect();
        let mut text = String::new();
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

    /// Inserts the cluster password into the address of a server.
    fn with_password(&self, route: &str) -> Result<String, ServerConfigError> {
        match route.strip_prefix("nats://") {
            Some(address) if !address.is_empty() && !address.contains(['@', '/']) => {
                Ok(format!("nats://{USER}:{}@{address}", self.password.0))
            }
            // The address contains a password, which messages must not show.
            Some(address) if address.contains('@') => {
                Err(ServerConfigError::Route { found: "an address with a user".to_owned() })
            }
            _ => Err(ServerConfigError::Route { found: format!("{route:?}") }),
        }
    }
}
