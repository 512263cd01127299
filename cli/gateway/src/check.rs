//! The output of `check`: the effective configuration and the plan derived from it.

use std::path::Path;

use crate::{config::Config, documents::PlanDocument, error::GatewayError, plan::Plan, toml_text};

/// Checks a configuration; with `online` also against the controls.
///
/// # Errors
/// The first error found.
pub fn check(path: &Path, online: bool, json: bool) -> Result<String, GatewayError> {
    let plan = Plan::new(Config::read(path)?)?;
    let found = if online { plan.online()? } else { plan.document()? };
    if json { line(&found) } else { Ok(text(&found, &plan.config)) }
}

/// The effective configuration as TOML, with the derived settings in comments, so that the output is a valid configuration.
pub fn text(found: &PlanDocument, config: &Config) -> String {
    let mut text = config.effective_toml();
    let follows = toml_text::of(found, &["notes", "configuration", "defaults"]);
    text += "\n";
    for line in follows.lines() {
        text += format!("# {line}").trim_end();
        text += "\n";
    }
    for note in &found.notes {
        text += &wrapped(note);
    }
    text
}

fn wrapped(note: &str) -> String {
    let (mut text, mut line) = (String::new(), "# note:".to_owned());
    for word in note.split(' ') {
        if line.chars().count() + 1 + word.chars().count() > 79 {
            text += &line;
            text += "\n";
            "#      ".clone_into(&mut line);
        }
        line += " ";
        line += word;
    }
    text + &line + "\n"
}

/// Serializes a document as one line of JSON.
///
/// # Errors
/// The document cannot be serialized; this does not occur with the gateway's own documents.
pub fn line(document: &impl serde::Serialize) -> Result<String, GatewayError> {
    let text = serde_json::to_string(document);
    let text = text.map_err(|e| GatewayError::system("JSON", e.into()))?;
    Ok(text + "\n")
}
