//! The port on which the servers of a cluster reach one another: whoever joins there reads and writes everything, so it asks
//! for a password, and for certificates where the servers have them.

use std::{
    fmt::{self, Write},
    path::PathBuf,
};

use sha2::{Digest, Sha256};

use crate::{
    manifest::hex,
    permissions::{NoConfiguration, ServerTls, quoted},
};

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

/// A server among the others of its cluster.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cluster {
    /// The name of the cluster.
    pub name: String,
    /// The address on which the other servers reach this one.
    pub listen: String,
    /// The addresses of the servers of the cluster, `nats://HOST:PORT`.
    pub routes: Vec<String>,
    /// The password by which they know one another.
    pub password: RoutePassword,
    /// Certificates by which they know one another's, PEM; `None`: those of the system. Used where the server has TLS.
    pub roots: Option<PathBuf>,
}

impl Cluster {
    /// The table of the server's configuration, with a line end.
    pub(crate) fn text(&self, tls: Option<&ServerTls>) -> Result<String, NoConfiguration> {
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
