//! The hidden command `schema`: the JSON Schemas of this program's documents.

use std::path::{Path, PathBuf};

use serde_json::json;

use super::{Answer, write_file};
use crate::{answers, failure::Failure};

/// Write the JSON Schemas of the documents that --json prints
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Folder for the files
    folder: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
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
        tolerances_met: true,
        json: json!({ "folder": folder.display().to_string(), "files": names }),
        text: format!("{} files in {}\n", names.len(), folder.display()),
        notes: Vec::new(),
        failed: None,
    })
}
