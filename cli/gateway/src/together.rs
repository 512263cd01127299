//! What two machines of one process must not have in common: a device, the folder of an audit log, their place in a fleet, the address of a
//! dashboard or of another system that reads it, its name at a broker, a configuration.

use std::{
    collections::{BTreeSet, HashMap},
    ffi::OsString,
    fmt,
    net::{IpAddr, SocketAddr},
    os::unix::fs::MetadataExt,
    path::{Path, PathBuf},
    thread,
};

use crate::{
    config::{Config, Several},
    error::GatewayError,
    lock,
};

/// Something of which every machine needs one of its own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Common {
    /// The configuration itself.
    Config(PathBuf),
    /// A device, by the URLs under which the two machines name it.
    Device([String; 2]),
    /// The folder of the audit log.
    Folder(PathBuf),
    /// The address at which the two listen, each with its table: that of the second may be another one that overlaps.
    Listens([(&'static str, SocketAddr); 2]),
    /// The name of the client at a broker: both their URLs and it.
    Client([String; 2], String),
    /// The name in the fleet.
    Identity(String),
    /// The folder of what the centre has sent.
    FleetFolder(PathBuf),
}

impl fmt::Display for Common {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Config(path) => write!(f, "config = \"{}\"", path.display()),
            Self::Device([one, other]) if one == other => write!(f, "the device {one}"),
            Self::Device([one, other]) => write!(f, "one device, {one} and {other}"),
            Self::Folder(path) => write!(f, "[audit] dir = \"{}\"", path.display()),
            Self::Listens([(table, one), other]) if (*table, *one) == *other => {
                write!(f, "[{table}] listen = {one}")
            }
            Self::Listens([(table, one), (other_table, other)]) if table == other_table => {
                write!(f, "one port, [{table}] listen = {one} and {other}")
            }
            Self::Listens([(table, one), (other_table, other)]) => {
                write!(
                    f,
                    "one port, [{table}] listen = {one} and [{other_table}] listen = {other}"
                )
            }
            Self::Identity(name) => write!(f, "[fleet] machine = {name}"),
            Self::FleetFolder(path) => write!(f, "[fleet] dir = \"{}\"", path.display()),
            Self::Client([one, other], name) if one == other => {
                write!(f, "[sparkplug] group and node at {one}: the client {name}")
            }
            Self::Client([one, other], name) => {
                write!(
                    f,
                    "[sparkplug] group and node at one broker, {one} and {other}: the client {name}"
                )
            }
        }
    }
}

/// One machine: its name, the path of its configuration, and what that says.
pub(crate) type Member<'a> = (&'a str, &'a Path, &'a Config);

/// Refuses what two machines, or a machine and the overview, have in common.
pub(crate) fn check(several: &Several, members: &[Member<'_>]) -> Result<(), GatewayError> {
    let refused = |one: &str, other: &str, common: Common| GatewayError::InCommon {
        file: several.file.clone(),
        machines: Box::new([one, other].map(str::to_owned)),
        common: Box::new(common),
    };
    let mut files: HashMap<PathBuf, &str> = HashMap::new();
    for (name, path, _) in members {
        if let Some(before) = files.insert(canonical(path), name) {
            return Err(refused(before, name, Common::Config((*path).to_owned())));
        }
    }
    let mut devices: HashMap<String, (&str, String)> = HashMap::new();
    for ((name, ..), reached) in members.iter().zip(all_reached(members)) {
        for (url, device) in reached {
            let before = devices.insert(device, (name, url.clone()));
            if let Some((other, before)) = before.filter(|(other, _)| other != name) {
                return Err(refused(other, name, Common::Device([before, url])));
            }
        }
    }
    let mut folders: HashMap<Folder, &str> = HashMap::new();
    for (name, _, config) in members {
        if let Some(before) = folders.insert(Folder::of(&config.audit_dir), name) {
            let folder = Common::Folder(config.audit_dir.clone());
            return Err(refused(before, name, folder));
        }
    }
    let mut fleet: HashMap<Folder, &str> = HashMap::new();
    let mut identities: HashMap<String, &str> = HashMap::new();
    for (name, _, config) in members {
        let Some(own) = &config.fleet else { continue };
        if let Some(before) = fleet.insert(Folder::of(&own.dir), name) {
            let folder = Common::FleetFolder(own.dir.clone());
            return Err(refused(before, name, folder));
        }
        let machine = own.identity.machine.to_string();
        if let Some(before) = identities.insert(machine.clone(), name) {
            return Err(refused(before, name, Common::Identity(machine)));
        }
    }
    let mut listening = vec![("the overview", ("dashboard", several.dashboard.listen))];
    for (name, _, config) in members {
        let own = listened(config);
        for address in &own {
            for (before, other) in &listening {
                if overlap(other.1, address.1) {
                    let both = Common::Listens([*other, *address]);
                    return Err(refused(before, name, both));
                }
            }
        }
        listening.extend(own.into_iter().map(|address| (*name, address)));
    }
    clients(members).map_or(Ok(()), |([one, other], common)| {
        Err(refused(one, other, common))
    })
}

/// The addresses at which a machine listens, each with its table.
fn listened(config: &Config) -> Vec<(&'static str, SocketAddr)> {
    let shdr = config.interop.shdr.as_ref();
    let shdr = shdr.map(|shdr| ("shdr", shdr.listen));
    let opc_ua = config.interop.opc_ua.as_ref();
    let opc_ua = opc_ua.map(|opc_ua| ("opc_ua", opc_ua.listen));
    [("dashboard", config.dashboard.listen)]
        .into_iter()
        .chain(shdr)
        .chain(opc_ua)
        .collect()
}

/// Two machines that a broker would take for one client, or those who hear it for one edge node.
fn clients<'a>(members: &[Member<'a>]) -> Option<([&'a str; 2], Common)> {
    let mut nodes: HashMap<(String, u16, String), (&str, &str)> = HashMap::new();
    for (name, _, config) in members {
        let Some(node) = &config.interop.sparkplug else {
            continue;
        };
        let (host, client) = (node.host.to_ascii_lowercase(), node.client());
        let before = nodes.insert((host, node.port, client.clone()), (name, &node.url));
        if let Some((before, url)) = before {
            let urls = [url.to_owned(), node.url.clone()];
            return Some(([before, name], Common::Client(urls, client)));
        }
    }
    None
}

/// The devices that each machine reaches, with the URLs that lead there. A host whose name nobody resolves takes its time, and
/// takes it beside the others.
fn all_reached(members: &[Member<'_>]) -> Vec<BTreeSet<(String, String)>> {
    thread::scope(|scope| {
        let asked: Vec<_> = members
            .iter()
            .map(|(_, _, config)| scope.spawn(|| lock::reached(config)))
            .collect();
        let told = asked.into_iter().map(thread::ScopedJoinHandle::join);
        told.map(Result::unwrap_or_default).collect()
    })
}

/// Two sockets of which the second could not be had. Port 0 is one that is free.
fn overlap(one: SocketAddr, other: SocketAddr) -> bool {
    let [a, b] = [one, other].map(|address| address.ip().to_canonical());
    let all = |ip: IpAddr| ip.is_unspecified();
    one.port() == other.port() && one.port() != 0 && (a == b || all(a) || all(b))
}

/// A folder by what it is, not by its spelling: by its number where it is there, otherwise by the folder in which it would be
/// made and the rest of its path.
#[derive(PartialEq, Eq, Hash)]
struct Folder {
    number: Option<(u64, u64)>,
    below: Vec<OsString>,
}

impl Folder {
    fn of(path: &Path) -> Self {
        let mut below = Vec::new();
        for above in path.ancestors() {
            let found = if above == Path::new("") {
                Path::new(".").metadata()
            } else {
                above.metadata()
            };
            if let Ok(found) = found {
                below.reverse();
                return Self {
                    number: Some((found.dev(), found.ino())),
                    below,
                };
            }
            below.extend(above.file_name().map(OsString::from));
        }
        below.reverse();
        Self {
            number: None,
            below,
        }
    }
}

fn canonical(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_that_one_socket_covers_overlap() {
        let overlap = |one: &str, other: &str| {
            let [one, other] = [one, other].map(|text| text.parse().expect("an address"));
            assert_eq!(super::overlap(one, other), super::overlap(other, one));
            super::overlap(one, other)
        };
        assert!(overlap("127.0.0.1:8080", "127.0.0.1:8080"));
        assert!(overlap("0.0.0.0:8080", "127.0.0.1:8080"));
        assert!(overlap("[::]:8080", "192.0.2.7:8080"));
        assert!(overlap("[::ffff:127.0.0.1]:8080", "127.0.0.1:8080"));
        assert!(!overlap("127.0.0.1:8080", "127.0.0.1:8081"));
        assert!(!overlap("127.0.0.1:8080", "127.0.0.2:8080"));
        assert!(!overlap("127.0.0.1:0", "127.0.0.1:0"));
    }

    #[test]
    fn a_folder_is_one_under_every_spelling() {
        let dir = tempfile::tempdir().expect("writable");
        let there = dir.path().join("there");
        std::fs::create_dir(&there).expect("writable");
        let link = dir.path().join("link");
        std::os::unix::fs::symlink(&there, &link).expect("writable");
        let same = |a: &Path, b: &Path| Folder::of(a) == Folder::of(b);
        assert!(same(&there, &link));
        assert!(same(&there.join("new/audit"), &link.join("new/audit")));
        assert!(!same(&there.join("new"), &there));
        assert!(!same(&there.join("one"), &there.join("two")));
    }
}
