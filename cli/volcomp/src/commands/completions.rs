use clap::Command;
use clap_complete::{Shell, generate};
use schemars::JsonSchema;
use serde::Serialize;

use super::Answer;
use crate::failure::Failure;

/// Print a completion script for a shell
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp completions bash > volcomp.bash
  volcomp completions zsh > _volcomp")]
pub(crate) struct CompletionsArguments {
    /// Shell
    shell: Shell,
}

/// Result of `volcomp completions`: the script for a shell.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Completions {
    /// Shell for which the script is written.
    shell: String,
    /// Text of the completion script, to be sourced by the shell.
    script: String,
}

pub(crate) fn run(
    arguments: &CompletionsArguments,
    command: &mut Command,
) -> Result<Answer, Failure> {
    let mut script = Vec::new();
    generate(arguments.shell, command, "volcomp", &mut script);
    let script = String::from_utf8(script)
        .map_err(|e| Failure::Work(format!("the script of the shell: {e}")))?;
    let document = Completions { shell: arguments.shell.to_string(), script: script.clone() };
    Answer::new(&document, script, Vec::new())
}
