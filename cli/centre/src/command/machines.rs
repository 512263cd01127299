use std::{collections::BTreeMap, fmt::Write};

use volcomp_fleet::{Identity, MachineId};

use super::{
    arguments::AddMachine,
    machine_named, open, print, print_json,
    server::generate_nkey,
    shown, signing_key,
    text::{self, MachineModel, MachineView},
};
use crate::{
    Error,
    clock::now_s,
    config::Config,
    issue::settle,
    models::NewModel,
    records::{Live, Machine, Model, Version},
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
