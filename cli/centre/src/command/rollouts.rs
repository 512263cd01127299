//! Roll-out commands. The running centre advances the roll-outs.

use volcomp_fleet::MachineId;

use super::{
    arguments::{RequestCommand, StartRollout},
    machine_named,
    models::named,
    open, print, print_json, text,
};
use crate::{
    Error,
    config::Config,
    models::fits,
    records::Machine,
    rollout::{Rules, UserRequest},
    versions,
};

pub(super) fn start(config: &Config, start: &StartRollout, by: &str) -> Result<(), Error> {
    let store = open(config)?;
    let (model, _) = named(&store, &start.model)?;
    let known = store.machines()?;
    let chosen: Vec<&Machine> = if start.all {
        known.iter().filter(|one| fits(&model, one).is_ok()).collect()
    } else {
        let mut chosen = Vec::new();
        for name in &start.machine {
            let name: MachineId = machine_named(name)?;
            let mut known = known.iter();
            let machine =
                known.find(|machine| machine.identity.machine == name).ok_or_else(|| {
                    Error::Wrong(format!("found no machine {name}: see `machine list`"))
                })?;
            fits(&model, machine)?;
            chosen.push(machine);
        }
        chosen
    };
    if chosen.is_empty() {
        return Err(Error::Wrong(format!(
            "found no machine with the structure and the axes of the model {}",
            model.name
        )));
    }
    if start.all && chosen.len() > 1 && !start.same_model {
        return Err(Error::Wrong(format!(
            "--all: found {} with the structure and the axes of the model {}, expected one: a model is valid for the machine on which it was measured; name it with `--machine NAME`, or send the model to all with `--same-model`",
            text::counted(chosen.len()),
            model.name
        )));
    }
    let mut machines: Vec<(MachineId, bool)> = Vec::new();
    for machine in chosen {
        let name = &machine.identity.machine;
        if !machines.iter().any(|(known, _)| known == name) {
            machines.push((name.clone(), machine.canary));
        }
    }
    let rules = Rules {
        soak_s: start.soak_s.unwrap_or(config.rollout.soak_s),
        tolerate: start.tolerate.unwrap_or(config.rollout.tolerate),
        ..config.rollout.clone()
    };
    rules.check().map_err(|(key, why)| Error::Wrong(format!("{key}: {why}")))?;
    let rollout = store.begin_rollout(&model.sha256, &machines, rules, by)?;
    let mut report = text::started(&rollout, &model);
    if rollout.targets.len() > 1 {
        report.push_str(
            "note: all receive the same model: it is valid for the machine on which it was measured\n",
        );
    }
    print(&report)
}

pub(super) fn back(config: &Config, machine: &str, by: &str) -> Result<(), Error> {
    let store = open(config)?;
    let name = machine_named(machine)?;
    let rules = config.rollout.clone();
    let (rollout, model) = versions::start_way_back(&store, &name, rules, by)?;
    print(&text::started(&rollout, &model))
}

pub(super) fn keep(config: &Config, id: u64, machine: &str, by: &str) -> Result<(), Error> {
    let name = machine_named(machine)?;
    open(config)?.keep_model(id, &name, by)?;
    print(&format!("recorded: {name} keeps the model of roll-out {id}\n"))
}

pub(super) fn status(config: &Config, id: Option<u64>, json: bool) -> Result<(), Error> {
    const MAX_LISTED: u32 = 10;
    let store = open(config)?;
    let rollouts = match id {
        Some(id) => vec![(store.rollout(id)?).ok_or_else(|| Error::missing("roll-out", &id))?],
        None => store.rollouts(MAX_LISTED)?,
    };
    if json {
        print_json(&rollouts)
    } else if rollouts.is_empty() {
        print("there is no roll-out yet\n")
    } else {
        print(&text::rollouts(&rollouts, id.is_some()))
    }
}

pub(super) fn request(config: &Config, request: RequestCommand, by: &str) -> Result<(), Error> {
    let store = open(config)?;
    let (id, request) = match request {
        RequestCommand::Pause { id } => (id, UserRequest::Pause),
        RequestCommand::Resume { id } => (id, UserRequest::Resume),
        RequestCommand::Stop { id } => (id, UserRequest::Abort),
        RequestCommand::Confirm { id, machine, hash } => {
            let machine = machine_named(&machine)?;
            (id, UserRequest::Confirm { machine, hash })
        }
    };
    store.request_rollout_change(id, &request, by)?;
    print("recorded; the running centre applies it\n")
}
