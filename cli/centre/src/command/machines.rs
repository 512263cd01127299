//! Commands for machines: registration, keys, server configuration, audit log and alarms.

use std::{
    collections::BTreeMap,
    fmt::Write,
    os::{fd::AsFd, unix::fs::PermissionsExt},
    path::Path,
};

use nkeys::KeyPair;
use volcomp_document::private;
use volcomp_fleet::{
    Cluster, Identity, LinkSettings, MachineId, MachineUser, RoutePassword, ServerSettings,
    server::write_private,
};

use crate::{
    Error,
    clock::now_s,
    command::{
        arguments::AddMachine,
        machine_named, open, print, print_json, shown, signing_key,
        text::{self, MachineModel, MachineView},
    },
    config::Config,
    issue::settle,
    keys::{Key, content, failed, write_secret},
    models::NewModel,
    records::{Live, Machine, Model, Version},
    store::Store,
    versions::load_active_version,
};

pub(super) fn add(config: &Config, add: &AddMachine, by: &str) -> Result<(), Error> {
    let store = open(config)?;
    let identity = Identity {
        site: (add.site.parse()).map_err(|e| Error::Wrong(format!("the name of a site: {e}")))?,
        machine: machine_named(&add.machine)?,
    };
    let like = NewModel::of_file(&add.like, by)?.model;
    let name = &identity.machine;
    store.change_machine(name, by, |before| {
        let mut machine = named(before, &identity, add, like);
        machine.check()?;
        if let Some(file) = &add.new_nkey {
            machine.nkey = Some(generate_nkey(file)?);
        }
        Ok(machine)
    })?;
    let mut report = format!("{name} is registered\n");
    if let Some(file) = &add.new_nkey {
        let _ = writeln!(
            report,
            "the seed of its nkey is in {}: copy it to the gateway, and reload the server with its new configuration (nats-config)",
            shown(file)
        );
    }
    print(&report)
}

/// Builds the machine record from the arguments. Options that are not given keep the value in `before`. Only `machine enable` enables a machine.
fn named(before: Option<Machine>, identity: &Identity, add: &AddMachine, like: Model) -> Machine {
    let Model { structure, axes, .. } = like;
    let new = || Machine::new(identity.clone(), String::new(), String::new(), Vec::new());
    let before = before.unwrap_or_else(new);
    Machine {
        identity: identity.clone(),
        serial: add.serial.clone(),
        structure,
        axes,
        nkey: add.nkey.clone().or(before.nkey),
        address: add.address.clone().unwrap_or(before.address),
        control: add.control.clone().unwrap_or(before.control),
        enable: before.enable && !add.disabled,
        canary: before.canary || add.canary,
        due_days: add.due_days.or(before.due_days),
        condition_s: add.condition_s.or(before.condition_s),
        telemetry_s: add.telemetry_s.or(before.telemetry_s),
        note: add.note.clone().unwrap_or(before.note),
    }
}

pub(super) fn list(config: &Config, json: bool) -> Result<(), Error> {
    let store = open(config)?;
    let (mut live, mut versions) = (store.live()?, store.newest_versions()?);
    let models: BTreeMap<String, String> =
        (store.models()?.into_iter()).map(|model| (model.sha256, model.name)).collect();
    let named = |version: &Version| MachineModel {
        version: version.version,
        model: version.model.clone(),
        name: models.get(&version.model).cloned().unwrap_or_default(),
    };
    let now_s = now_s();
    let mut shown = Vec::new();
    for machine in store.machines()? {
        let name = &machine.identity.machine;
        let (live, version) = (live.remove(name), versions.remove(name));
        let in_force = match &live {
            Some(live) => load_active_version(&store, name, version.as_ref(), Some(live))?,
            None => None,
        };
        let made = live.as_ref().and_then(Live::made);
        shown.push(MachineView {
            age_s: made.map(|made| (now_s - made.at_s).max(made.late_s)),
            live,
            wanted: version.as_ref().map(named),
            in_force: in_force.as_ref().map(named),
            version,
            machine,
        });
    }
    if json { print_json(&shown) } else { print(&text::machines(&shown)) }
}

pub(super) fn remove(config: &Config, machine: &str, by: &str) -> Result<(), Error> {
    let name = machine_named(machine)?;
    if open(config)?.remove_machine(&name, by)? {
        print(&format!(
            "{name} is removed; reload the server with its new configuration (nats-config), which revokes its nkey\n"
        ))
    } else {
        Err(no_machine(&name))
    }
}

pub(super) fn enable(config: &Config, machine: &str, enable: bool, by: &str) -> Result<(), Error> {
    let name = machine_named(machine)?;
    let key = signing_key(config)?;
    let store = open(config)?;
    store.change_machine(&name, by, |known| {
        let known = known.ok_or_else(|| no_machine(&name))?;
        Ok(Machine { enable, ..known })
    })?;
    match settle(&store, &key, &name, by) {
        Ok(Some(issued)) => {
            print(&format!("version {} is issued; the running centre sends it\n", issued.version))
        }
        Ok(None) => print(
            "its newest manifest contains this setting already; the running centre sends it if necessary\n",
        ),
        // The first manifest of the machine will contain this setting.
        Err(Error::NoModelYet { .. }) => {
            let may = if enable { "may" } else { "must not" };
            print(&format!(
                "recorded: {name} {may} be corrected; it has no model yet, and receives this setting with its first one\n"
            ))
        }
        Err(other) => Err(Error::Failed(other.to_string())),
    }
}

fn no_machine(name: &MachineId) -> Error {
    Error::Wrong(format!("found no machine {name}: see `machine list`"))
}

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

fn generate_nkey(file: &Path) -> Result<String, Error> {
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
