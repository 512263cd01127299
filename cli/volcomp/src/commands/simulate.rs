use std::{
    collections::BTreeMap,
    fmt::Write as _,
    path::{Path, PathBuf},
};

use schemars::JsonSchema;
use serde::Serialize;
use sha2::{Digest, Sha256};
use volcomp_model::hexadecimal;
use volcomp_shop::{CALIBRATED, Shop, ShopError};

use super::{Answer, same_file, write_file};
use crate::{
    failure::Failure,
    output::{self, OutputFile},
};

/// Simulate measurements: files of a true machine and noisy instruments, with the calibration and observations files that
/// read them
///
/// Overwrites the files of an earlier run. If the folder has a file of the same name that is not exactly as this command
/// wrote it, nothing is written. simulated-files.sha256 lists the written files.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp simulate shop.toml -o lasers
  volcomp --json simulate shop.toml -o lasers")]
pub(crate) struct SimulateArguments {
    /// Shop file (TOML): true machine, instrument, lines, observations
    shop: PathBuf,
    /// Folder for the files, created if missing
    #[arg(long, short)]
    output: PathBuf,
}

/// Result of `volcomp simulate`: the written files, and the commands that evaluate them.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Simulate {
    /// Folder that the files were written to.
    folder: String,
    /// Names of the written files.
    files: Vec<String>,
    /// Names of the written files that replaced a file of an earlier run.
    replaced: Vec<String>,
    /// Path of the calibration file that lists the measurement lines; null if only observations
    /// were simulated.
    calibration: Option<String>,
    /// Path of the observations file; null if no observations were simulated.
    observations: Option<String>,
    /// Commands that produce a machine file from the simulated files, in order, to be run in the
    /// current folder.
    next: Vec<String>,
}

pub(crate) fn run(arguments: &SimulateArguments) -> Result<Answer, Failure> {
    let shop = Shop::read(&arguments.shop)?;
    let folder = &arguments.output;
    let Written { names, replaced } = write(&shop, folder)?;
    let path = |name: &str| {
        let is_there = names.iter().any(|written| written == name);
        is_there.then(|| folder.join(name).display().to_string())
    };
    let (calibration, observations) = (path("calibration.toml"), path("observations.toml"));
    let mut text = format!("{} files in {}", names.len(), folder.display());
    if !replaced.is_empty() {
        let _ = write!(text, ", {} of them over earlier ones", replaced.len());
    }
    text.push('\n');
    let next = next(folder, calibration.is_some(), observations.is_some());
    for (command, first) in next.iter().zip(["next", "then"]) {
        let _ = writeln!(text, "{first}: {command}");
    }
    let document = Simulate {
        folder: folder.display().to_string(),
        calibration,
        observations,
        files: names,
        replaced,
        next,
    };
    Answer::new(&document, text, Vec::new())
}

/// The commands that produce a machine file from the files in a folder, in order. If there are lines and observations,
/// `observations.toml` starts from the machine calibrated from the lines.
fn next(folder: &Path, lines: bool, observations: bool) -> Vec<String> {
    let file = |name: &str| for_shell(&folder.join(name).display().to_string());
    let call = |command: &str, read: &str, output: &str| {
        format!("volcomp {command} {} -o {output}", file(read))
    };
    let last = "MACHINE.toml";
    match (lines, observations) {
        (true, true) => vec![
            call("calibrate", "calibration.toml", &file(CALIBRATED)),
            call("identify", "observations.toml", last),
        ],
        (true, false) => vec![call("calibrate", "calibration.toml", last)],
        (false, _) => vec![call("identify", "observations.toml", last)],
    }
}

/// Quotes a path as one shell word that no program parses as an option.
fn for_shell(path: &str) -> String {
    if path.starts_with('-') {
        return for_shell(&format!("./{path}"));
    }
    let is_plain = |c: char| {
        let separates = cfg!(windows) && c == '\\';
        c.is_alphanumeric() || "/._-:~+,@".contains(c) || separates
    };
    // A shell expands a leading `~` to the home folder, except in quotes.
    if path.chars().all(is_plain) && !path.starts_with('~') {
        path.to_owned()
    } else if path.chars().all(|c| is_plain(c) || c == ' ') {
        format!("\"{path}\"")
    } else {
        // In double quotes a shell would expand `$` and backticks.
        format!("'{}'", path.replace('\'', r"'\''"))
    }
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

pub(crate) struct Written {
    names: Vec<String>,
    replaced: Vec<String>,
}

pub(crate) fn write(shop: &Shop, folder: &Path) -> Result<Written, Failure> {
    refuse_inputs(shop, folder)?;
    make(folder)?;
    let mut list = WrittenFiles::read(folder)?;
    // Opening the first file checks that the folder is writable before the work starts.
    let first = OutputFile::open(&folder.join("machine.toml"))?;
    let bar = output::bar(shop.count(), "lines and observations measured");
    let files = shop.files(|done, _| bar.set_position(done as u64))?;
    bar.finish_and_clear();
    for (name, text) in &files {
        list.refuse_others(folder, name, text)?;
    }
    let mut first = Some(first);
    let mut written = Written { names: Vec::new(), replaced: Vec::new() };
    for (name, text) in files {
        let path = folder.join(&name);
        if path.exists() {
            written.replaced.push(name.clone());
        }
        let file = match first.take().filter(|_| name == "machine.toml") {
            Some(file) => file,
            None => OutputFile::open(&path)?,
        };
        file.write_whole(&text)?;
        list.add(&name, &text);
        written.names.push(name);
    }
    list.write(folder)?;
    Ok(written)
}

pub(crate) fn make(folder: &Path) -> Result<(), Failure> {
    std::fs::create_dir_all(folder)
        .map_err(|e| Failure::Input(format!("{}: cannot be made a folder: {e}", folder.display())))
}

fn refuse_inputs(shop: &Shop, folder: &Path) -> Result<(), Failure> {
    let mut names = shop.file_names();
    let writes = |wanted: &str| names.iter().any(|name| name == wanted);
    if writes("calibration.toml") && writes("observations.toml") {
        // The next command writes this file.
        names.push(CALIBRATED.to_owned());
    }
    for name in names {
        if let Some(input) = same_file(&shop.inputs, &folder.join(&name)) {
            return Err(Failure::Input(format!(
                "--output {}: {name} would be written over {}, which this shop reads; expected another folder",
                folder.display(),
                input.display()
            )));
        }
    }
    Ok(())
}

/// Name of the list of written files. Measurements and observations have other extensions, so no file of a shop has
/// this name.
const LIST: &str = "simulated-files.sha256";
/// The first line of the list. It identifies a list written by this program.
const FIRST_LINE: &str = "# Written by volcomp simulate, which writes over these files while they are as listed here: SHA-256 and name";

/// The files of earlier runs, each with the SHA-256 of its written content, in the format of `sha256sum`.
struct WrittenFiles(BTreeMap<String, String>);

impl WrittenFiles {
    fn read(folder: &Path) -> Result<Self, Failure> {
        let path = folder.join(LIST);
        let Some(bytes) = content(&path)? else {
            return Ok(Self(BTreeMap::new()));
        };
        let text = String::from_utf8_lossy(&bytes);
        let mut lines = text.lines();
        if lines.next() != Some(FIRST_LINE) {
            return Err(not_mine(&path));
        }
        let entry = |line: &str| {
            let (digest, name) = line.split_once("  ")?;
            Some((name.to_owned(), digest.to_owned()))
        };
        Ok(Self(lines.filter_map(entry).collect()))
    }

    /// Refuses to overwrite an existing file, unless the file is unchanged since an earlier run or already has this
    /// text.
    fn refuse_others(&self, folder: &Path, name: &str, text: &str) -> Result<(), Failure> {
        let path = folder.join(name);
        let Some(found) = content(&path)? else {
            return Ok(());
        };
        let is_listed = || self.0.get(name) == Some(&hexadecimal(&Sha256::digest(&found)));
        if found == text.as_bytes() || is_listed() {
            return Ok(());
        }
        Err(not_mine(&path))
    }

    fn add(&mut self, name: &str, text: &str) {
        self.0.insert(name.to_owned(), hexadecimal(&Sha256::digest(text)));
    }

    fn write(&self, folder: &Path) -> Result<(), Failure> {
        let mut text = format!("{FIRST_LINE}\n");
        for (name, digest) in &self.0 {
            let _ = writeln!(text, "{digest}  {name}");
        }
        write_file(&folder.join(LIST), &text)
    }
}

pub(super) fn write_listed(folder: &Path, files: &[(&str, &str)]) -> Result<(), Failure> {
    let mut list = WrittenFiles::read(folder)?;
    for (name, text) in files {
        list.refuse_others(folder, name, text)?;
    }
    for (name, text) in files {
        write_file(&folder.join(name), text)?;
        list.add(name, text);
    }
    list.write(folder)
}

fn not_mine(path: &Path) -> Failure {
    Failure::in_file(
        path,
        "found a file that `volcomp simulate` did not write, or that was changed since: expected another folder, or this file out of the way",
    )
}

/// The bytes of a file; `None` if the file does not exist.
fn content(path: &Path) -> Result<Option<Vec<u8>>, Failure> {
    if !path.exists() {
        return Ok(None);
    }
    let read = std::fs::read(path);
    read.map(Some).map_err(|e| Failure::in_file(path, e))
}
