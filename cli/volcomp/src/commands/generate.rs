//! The hidden commands `man` and `schema`, which write what is made from this program's own source: its man pages
//! (`docs/man/`) and the JSON Schemas of its answers (`docs/schema/`).

use std::path::{Path, PathBuf};

use clap::Command;
use clap_mangen::Man;
use serde_json::json;

use super::{Answer, write_file};
use crate::{answers, failure::Failure};

/// Writes files that are made from this program
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Folder for the files
    folder: PathBuf,
}

/// One man page for the program and one for each command.
pub(crate) fn man(arguments: &Arguments, command: Command) -> Result<Answer, Failure> {
    let mut command = command.disable_help_subcommand(true);
    command.build();
    let mut files = Vec::new();
    let shown = command.get_subcommands().filter(|c| !c.is_hide_set());
    let pages = std::iter::once(command.clone()).chain(shown.cloned());
    for page in pages {
        let man = Man::new(page);
        let mut text = Vec::new();
        man.render(&mut text)
            .map_err(|e| Failure::Work(format!("a man page: {e}")))?;
        let text =
            String::from_utf8(text).map_err(|e| Failure::Work(format!("a man page: {e}")))?;
        files.push((man.get_filename(), text));
    }
    write(&arguments.folder, &files)
}

/// One JSON Schema for each document.
pub(crate) fn schemas(arguments: &Arguments) -> Result<Answer, Failure> {
    let mut files = Vec::new();
    for (name, schema) in answers::ALL {
        let text = serde_json::to_string_pretty(&schema())
            .map_err(|e| Failure::Work(format!("the schema of {name}: {e}")))?;
        files.push((format!("volcomp-{name}.json"), text + "\n"));
    }
    write(&arguments.folder, &files)
}

fn write(folder: &Path, files: &[(String, String)]) -> Result<Answer, Failure> {
    std::fs::create_dir_all(folder)
        .map_err(|e| Failure::in_file(folder, format_args!("cannot be made a folder: {e}")))?;
    for (name, text) in files {
        write_file(&folder.join(name), text)?;
    }
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    Ok(Answer {
        json: json!({ "folder": folder.display().to_string(), "files": names }),
        text: format!("{} files in {}\n", names.len(), folder.display()),
        notes: Vec::new(),
    })
}
