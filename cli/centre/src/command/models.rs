use std::{fmt::Write as _, io::Write as _, path::Path};

use super::{arguments::AddModel, machine_named, open, print, print_json, text};
use crate::{
    Error,
    config::Config,
    models::{NewModel, Stage, compare, parameters},
    records::Model,
    store::Store,
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
