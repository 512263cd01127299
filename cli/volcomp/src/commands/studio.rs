use std::{
    net::SocketAddr,
    path::PathBuf,
    process::{Command, Stdio},
};

use volcomp_studio::{Folder, Studio, StudioError};

use super::Answer;
use crate::{failure::Failure, output};

/// Make a machine file from a folder of measurement files, in the browser
///
/// Serves a local web application: files, open questions, curves with bands, map and verdict; then machine file, report,
/// tables for controls and NC programs, and upload to a gateway or the centre. All data is in the folder: measurement
/// files, machine.toml, answers.json, calibration.toml, and the results in result/. Ends with Ctrl-C.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp studio lasers
  volcomp studio lasers --listen 127.0.0.1:8100 --no-browser")]
pub(crate) struct StudioArguments {
    /// Folder of the measurement files of one machine
    #[arg(value_name = "FOLDER", default_value = ".")]
    folder: PathBuf,
    /// Address of this computer to listen at; port 0: any free one
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1:0")]
    listen: SocketAddr,
    /// Print the address without opening a browser
    #[arg(long)]
    no_browser: bool,
}

pub(crate) fn run(arguments: &StudioArguments) -> Result<Answer, Failure> {
    let folder = Folder::open(&arguments.folder).map_err(Failure::input)?;
    let studio = Studio::listen(folder, arguments.listen).map_err(|error| match error {
        StudioError::System { .. } => Failure::Work(error.to_string()),
        other => Failure::input(other),
    })?;
    let url = studio.url();
    output::print(&format!("listening on {}\nopen {url}\n", studio.address()))?;
    if !arguments.no_browser {
        open(&url);
    }
    let ended = studio.run();
    ended.map_err(|error| Failure::Work(error.to_string()))?;
    Answer::new(&(), String::new(), Vec::new())
}

/// Opens the browser. If this fails, the user can open the address on standard output.
fn open(url: &str) {
    let program = if cfg!(target_os = "macos") {
        "open"
    } else if cfg!(windows) {
        "explorer"
    } else {
        "xdg-open"
    };
    let mut command = Command::new(program);
    command.arg(url).stdout(Stdio::null()).stderr(Stdio::null());
    if let Err(error) = command.spawn() {
        tracing::debug!("{program}: {error}");
    }
}
