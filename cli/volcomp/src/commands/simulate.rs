//! `volcomp simulate`: the virtual shop.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use volcomp_shop::{Shop, ShopError};

use super::Answer;
use crate::{answers::simulate::Simulate, failure::Failure, output::OutputFile, progress};

/// The virtual shop: makes measurement files of a truth machine and the files that read them
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Shop file (TOML): truth machine, instrument, lines, observations
    shop: PathBuf,
    /// Folder for the files; made when it is not there
    #[arg(long, short)]
    output: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let shop = Shop::read(&arguments.shop)?;
    let names = write(&shop, &arguments.output)?;
    let path = |name: &str| {
        let is_there = names.iter().any(|written| written == name);
        is_there.then(|| arguments.output.join(name).display().to_string())
    };
    let (calibration, observations) = (path("calibration.toml"), path("observations.toml"));
    let mut text = format!("{} files in {}\n", names.len(), arguments.output.display());
    for (command, file) in [("calibrate", &calibration), ("identify", &observations)] {
        if let Some(file) = file {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "next: volcomp {command} {file} -o MACHINE.toml");
        }
    }
    let document = Simulate {
        folder: arguments.output.display().to_string(),
        calibration,
        observations,
        files: names,
    };
    Answer::new(&document, text, Vec::new())
}

impl From<ShopError> for Failure {
    fn from(error: ShopError) -> Self {
        match error {
            ShopError::Input(place) => place.into(),
            ShopError::Read(error) => error.into(),
            ShopError::Machine(error) => error.into(),
            other => Self::input(other),
        }
    }
}

/// Writes every file of a shop into a folder; their names.
pub(crate) fn write(shop: &Shop, folder: &Path) -> Result<Vec<String>, Failure> {
    std::fs::create_dir_all(folder).map_err(|e| {
        Failure::Input(format!(
            "{}: cannot be made a folder: {e}",
            folder.display()
        ))
    })?;
    // Whether the folder can be written in is known before work starts.
    let first = OutputFile::open(&folder.join("machine.toml"))?;
    let bar = progress::bar(shop.count(), "lines and observations measured");
    let files = shop.files(|done, _| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    let mut first = Some(first);
    let mut names = Vec::new();
    for (name, text) in files {
        let mut file = match first.take().filter(|_| name == "machine.toml") {
            Some(file) => file,
            None => OutputFile::open(&folder.join(&name))?,
        };
        file.append(text.as_bytes())?;
        file.finish()?;
        names.push(name);
    }
    Ok(names)
}
