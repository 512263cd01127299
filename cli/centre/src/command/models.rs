//! Commands for models and their roll-outs.
//!
//! A command only stores a request; the running centre advances the roll-outs.

use std::{fmt::Write as _, io::Write as _, path::Path};

use volcomp_fleet::MachineId;

use crate::{
    Error,
    command::{
        arguments::{AddModel, RequestCommand, StartRollout},
        machine_named, open, print, print_json, text,
    },
    config::Config,
    models::{NewModel, Stage, compare, fits, parameters},
    records::{Machine, Model},
    rollout::{Rules, UserRequest},
    store::Store,
    versions,
};

pub(super) fn add(config: &Config, add: &AddModel, by: &str) -> Result<(), Error> {
    let day = add.measured.as_deref().unwrap_or_default();
    let new = NewModel::of_file(&add.file, by)?.with_day_and_note(day)?;
    let is_new = open(config)?.add_model(&new.model, &new.text)?;
    let mut report = String::new();
    for note in &new.model.notes {
        let _ = writeln!(report, "note: {note}");
    }
    let duplicate = match &add.measured {
        _ if is_new => String::new(),
        Some(day) => format!(" (already stored; measured on {day})"),
        None => " (already stored)".to_owned(),
    };
    let _ = writeln!(report, "{} {}{duplicate}", new.model.sha256, new.model.name);
    print(&report)
}

pub(super) fn list(config: &Config, json: bool) -> Result<(), Error> {
    let models = open(config)?.models()?;
    if json { print_json(&models) } else { print(&text::models(&models)) }
}

/// The only model whose checksum begins with `beginning`.
pub(super) fn named(store: &Store, beginning: &str) -> Result<(Model, String), Error> {
    let wrong = || {
        Error::Wrong(format!(
            "the model: found {beginning:?}, expected the beginning of one checksum of `model list`"
        ))
    };
    let model = store.model(beginning)?.ok_or_else(wrong)?;
    let text = store.model_text(&model.sha256)?.ok_or_else(wrong)?;
    Ok((model, text))
}

pub(super) fn show(config: &Config, beginning: &str) -> Result<(), Error> {
    let store = open(config)?;
    let (model, _) = named(&store, beginning)?;
    print(&text::model(&model))
}

pub(super) fn download(config: &Config, beginning: &str, output: &Path) -> Result<(), Error> {
    let store = open(config)?;
    let (model, text) = named(&store, beginning)?;
    let file = std::fs::OpenOptions::new().write(true).create_new(true).open(output);
    let written = file.and_then(|mut file| {
        file.write_all(text.as_bytes())?;
        file.sync_all()
    });
    written.map_err(|error| {
        let why = match error.kind() {
            std::io::ErrorKind::AlreadyExists => {
                "exists and is not replaced: name a new file".to_owned()
            }
            _ => format!("cannot be written: {error}"),
        };
        Error::Wrong(format!("{}: {why}", output.display()))
    })?;
    print(&format!("{}: {} bytes, SHA-256 {}\n", output.display(), model.bytes, model.sha256))
}

pub(super) fn diff(config: &Config, one: &str, other: &str) -> Result<(), Error> {
    let store = open(config)?;
    let (_, one) = named(&store, one)?;
    let (_, other) = named(&store, other)?;
    print(&compare(&one, &other)?)
}

pub(super) fn drift(config: &Config, machine: &str) -> Result<(), Error> {
    let store = open(config)?;
    let name = machine_named(machine)?;
    let mut stages = Vec::new();
    for version in store.versions(&name)?.into_iter().rev() {
        let (model, text) = named(&store, &version.model)?;
        let seen = stages.iter().any(|stage: &Stage| stage.sha256 == model.sha256);
        if !seen {
            let parameters = parameters(&text)?;
            let sha256 = model.sha256;
            stages.push(Stage { sha256, parameters });
        }
    }
    if stages.is_empty() {
        return print(&format!("{name} has had no model yet\n"));
    }
    print(&text::drift(&stages))
}

pub(super) fn start_rollout(config: &Config, start: &StartRollout, by: &str) -> Result<(), Error> {
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

pub(super) fn rollout_status(config: &Config, id: Option<u64>, json: bool) -> Result<(), Error> {
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

pub(super) fn request_rollout(
    config: &Config,
    request: RequestCommand,
    by: &str,
) -> Result<(), Error> {
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
