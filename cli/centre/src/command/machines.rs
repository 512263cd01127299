//! Machines on the command line.

use std::{collections::BTreeMap, fmt::Write};

use serde::Serialize;
use volcomp_fleet::{Identity, MachineId};

use super::{
    CommandError, arguments::AddMachine, machine_named, open, print, print_json, server::draw_nkey,
    shown, signing_key, text,
};
use crate::{
    config::Config,
    issue::{NotIssued, reissue},
    models::NewModel,
    records::{Live, Machine, Version},
    registration::check,
};

/// A machine with what is known of it now.
#[derive(Serialize)]
pub(super) struct Shown {
    #[serde(flatten)]
    pub(super) machine: Machine,
    pub(super) live: Option<Live>,
    pub(super) version: Option<Version>,
}

pub(super) fn add(config: &Config, add: AddMachine, by: &str) -> Result<(), CommandError> {
    let store = open(config)?;
    let identity = Identity {
        site: (add.site.parse())
            .map_err(|e| CommandError::Wrong(format!("the name of a site: {e}")))?,
        machine: machine_named(&add.machine)?,
    };
    let like = NewModel::of_file(&add.like, by)?.model;
    let before = store.machine(&identity.machine)?;
    let mut machine = Machine {
        identity,
        serial: add.serial,
        structure: like.structure,
        axes: like.axes,
        nkey: add.nkey.or(before.and_then(|machine| machine.nkey)),
        address: add.address,
        control: add.control,
        enable: !add.disabled,
        canary: add.canary,
        due_days: add.due_days,
        condition_s: add.condition_s,
        telemetry_s: add.telemetry_s,
        note: add.note,
    };
    check(&machine).map_err(|error| CommandError::Wrong(error.to_string()))?;
    if let Some(file) = &add.new_nkey {
        machine.nkey = Some(draw_nkey(file)?);
    }
    store.put_machine(&machine, by)?;
    let name = &machine.identity.machine;
    let mut said = format!("{name} is registered\n");
    if let Some(file) = &add.new_nkey {
        let _ = writeln!(
            said,
            "the seed of its nkey is in {}: copy it to the gateway, and take the server's new configuration into use (nats-config)",
            shown(file)
        );
    }
    print(&said)
}

pub(super) fn list(config: &Config, json: bool) -> Result<(), CommandError> {
    let store = open(config)?;
    let mut live: BTreeMap<MachineId, Live> = (store.live()?.into_iter())
        .map(|live| (live.machine.clone(), live))
        .collect();
    let mut versions: BTreeMap<MachineId, Version> = (store.newest_versions()?.into_iter())
        .map(|version| (version.machine.clone(), version))
        .collect();
    let shown: Vec<Shown> = (store.machines()?.into_iter())
        .map(|machine| Shown {
            live: live.remove(&machine.identity.machine),
            version: versions.remove(&machine.identity.machine),
            machine,
        })
        .collect();
    if json {
        print_json(&shown)
    } else {
        print(&text::machines(&shown))
    }
}

pub(super) fn remove(config: &Config, machine: &str, by: &str) -> Result<(), CommandError> {
    let name = machine_named(machine)?;
    if open(config)?.remove_machine(&name, by)? {
        print(&format!(
            "{name} is forgotten; take the server's new configuration into use (nats-config), so that its nkey opens nothing\n"
        ))
    } else {
        Err(no_machine(&name))
    }
}

pub(super) fn enable(
    config: &Config,
    machine: &str,
    enable: bool,
    by: &str,
) -> Result<(), CommandError> {
    let name = machine_named(machine)?;
    let key = signing_key(config)?;
    let store = open(config)?;
    let mut known = store.machine(&name)?.ok_or_else(|| no_machine(&name))?;
    known.enable = enable;
    store.put_machine(&known, by)?;
    match reissue(&store, &key, &name, by) {
        Ok(issued) => print(&format!(
            "version {} is issued; the running centre sends it\n",
            issued.version
        )),
        // It will be so in its first manifest.
        Err(NotIssued::NoModelYet { .. }) => print(&format!("{name} has no model yet\n")),
        Err(other) => Err(other.into()),
    }
}

fn no_machine(name: &MachineId) -> CommandError {
    CommandError::Wrong(format!("found no machine {name}: see `machine list`"))
}
