//! Keys, server configuration, audit log and alarms.

use std::{
    fmt::Write,
    os::{fd::AsFd, unix::fs::PermissionsExt},
    path::Path,
};

use nkeys::KeyPair;
use volcomp_document::private;
use volcomp_fleet::{
    Cluster, LinkSettings, MachineUser, RoutePassword, ServerSettings, server::write_private,
};

use super::{open, print, print_json, text};
use crate::{
    Error,
    config::Config,
    keys::{Key, content, failed, write_secret},
    store::Store,
};

pub(super) fn new_key(config: &Config, name: &str) -> Result<(), Error> {
    let key = Key::create(&config.keys.folder, name)?;
    print(&format!("{} {}\n", key.name, key.public()))
}

pub(super) fn list_keys(config: &Config) -> Result<(), Error> {
    let mut text = String::new();
    for key in Key::all(&config.keys.folder)? {
        let signs = if key.name == config.keys.sign_with { " signs" } else { "" };
        let _ = writeln!(text, "{} {}{signs}", key.name, key.public());
    }
    print(&text)
}

pub(super) fn generate_nkey(file: &Path) -> Result<String, Error> {
    let pair = KeyPair::new_user();
    let seed = pair.seed().map_err(|_| content(file, "the seed of an nkey"))?;
    write_secret(file, &seed)?;
    Ok(pair.public_key())
}

pub(super) fn new_nkey(file: &Path) -> Result<(), Error> {
    print(&format!("{}\n", generate_nkey(file)?))
}

/// Connection settings for the NATS server, and the centre's public nkey.
pub(super) fn link(config: &Config) -> Result<(LinkSettings, String), Error> {
    let file = &config.nats.nkey_file;
    let link = LinkSettings {
        url: config.nats.url.clone(),
        seed: private::read(file)?.trim().to_owned(),
        roots: config.nats.ca.clone(),
    };
    let expected = "the seed of the nkey of a user, SU and 56 letters and digits";
    let nkey = link.public_key().map_err(|_| content(file, expected))?;
    Ok((link, nkey))
}

pub(super) fn settings(config: &Config) -> Result<ServerSettings, Error> {
    let (link, centre) = link(config)?;
    let machines = open(config)?.machines()?;
    let server = &config.server;
    Ok(ServerSettings {
        name: server.name.clone(),
        listen: config.server_listen(),
        store: server.store.clone(),
        tls: server.tls(),
        cluster: server.cluster.as_ref().map(|name| Cluster {
            name: name.clone(),
            listen: server.cluster_listen.clone(),
            routes: server.routes.clone(),
            password: RoutePassword::of_seed(&link.seed),
            roots: config.nats.ca.clone(),
        }),
        centres: vec![centre],
        machines: (machines.into_iter())
            .filter_map(|machine| {
                Some(MachineUser { nkey: machine.nkey?, identity: machine.identity })
            })
            .collect(),
    })
}

pub(super) fn nats_config(config: &Config, output: Option<&Path>) -> Result<(), Error> {
    let settings = settings(config)?;
    let text = settings.text()?;
    if let Some(file) = output {
        return write_private(file, &text).map_err(failed(file));
    }
    if settings.cluster.is_some()
        && let Some(mode) = readable_output_mode()?
    {
        return Err(Error::Wrong(format!(
            "the configuration contains the password of the cluster: found an output file of mode {mode:03o}, expected `nats-config --output FILE`, which creates a file of mode 600"
        )));
    }
    print(&text)
}

/// Mode of the file that standard output is redirected to, if other users can read that file.
fn readable_output_mode() -> Result<Option<u32>, Error> {
    let printed = std::io::stdout().as_fd().try_clone_to_owned()?;
    let printed = std::fs::File::from(printed).metadata()?;
    let mode = printed.permissions().mode() & 0o777;
    Ok((printed.is_file() && private::is_open_to_others(mode)).then_some(mode))
}

pub(super) fn audit(config: &Config, count: u32, json: bool) -> Result<(), Error> {
    let store = open(config)?;
    let records = store.audit_records(None, count)?;
    if json {
        print_json(&records)?;
    } else {
        print(&text::audit(&records))?;
    }
    check_audit_chain(&store)
}

pub(super) fn check_audit_chain(store: &Store) -> Result<(), Error> {
    match store.broken_audit()? {
        None => Ok(()),
        Some(number) => Err(Error::Failed(format!(
            "audit log: record {number} does not match its predecessor: it or an earlier one was changed"
        ))),
    }
}

pub(super) fn alarms(config: &Config, all: bool, json: bool) -> Result<(), Error> {
    let store = open(config)?;
    let alarms = if all { store.alarms(None, 1000)? } else { store.open_alarms()? };
    if json { print_json(&alarms) } else { print(&text::alarms(&alarms)) }
}
