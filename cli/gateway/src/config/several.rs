//! The file of several machines: `[[machine]]` tables, each with the name of a machine and the path of its configuration,
//! and the overview's own `[dashboard]`.

use std::path::{Path, PathBuf};

use volcomp_document::{Document, InputError, Section};

use super::{Config, DashboardConfig, ROOT_KEYS, dashboard::dashboard};
use crate::error::GatewayError;

/// The largest number of machines in one process.
const MOST: usize = 64;
/// The largest number of characters of a name.
const LONGEST_NAME: usize = 40;

/// What `--config` may name: the configuration of one machine, or the file of several.
#[derive(Clone, Debug, PartialEq)]
pub enum ConfigFile {
    /// The configuration of one machine.
    One(Box<Config>),
    /// The file of several machines.
    Several(Several),
}

/// The file of several machines. Paths are relative to its folder.
#[derive(Clone, Debug, PartialEq)]
pub struct Several {
    /// The name of the file as messages have it.
    pub file: String,
    /// The machines, in order.
    pub machines: Vec<MachineEntry>,
    /// The overview and its protection.
    pub dashboard: DashboardConfig,
}

/// One table `[[machine]]` of the file of several machines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MachineEntry {
    /// The name of the machine in this process.
    pub name: String,
    /// The path of its configuration.
    pub config: PathBuf,
}

impl ConfigFile {
    /// Reads a configuration of one machine or the file of several.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        Ok(match Several::read(path)? {
            Some(several) => Self::Several(several),
            None => Self::One(Box::new(Config::read(path)?)),
        })
    }

    /// The configuration of one machine: the only one, or that of this name.
    ///
    /// # Errors
    /// No name where there are several machines, a name that none of them has, one where there is only one machine, and what is
    /// wrong with the configuration.
    pub fn machine(self, name: Option<&str>) -> Result<Config, GatewayError> {
        match (self, name) {
            (Self::One(config), None) => Ok(*config),
            (Self::One(config), Some(name)) => Err(GatewayError::OnlyMachine {
                file: config.file,
                name: name.to_owned(),
            }),
            (Self::Several(several), Some(name)) => Config::read(&several.machine(name)?.config),
            (Self::Several(several), None) => Err(GatewayError::WhichMachine {
                names: several.names(),
                file: several.file,
            }),
        }
    }
}

impl Several {
    /// Reads a file, where it is that of several machines; `None`: it is another one, whatever it says.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key what is wrong in it.
    pub fn read(path: &Path) -> Result<Option<Self>, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let file = path.display().to_string();
        Ok(Document::read(path)?.decode(|root| {
            let several = holds_several(&root).then(|| Self::decode(&root, &file, folder));
            several.transpose()
        })?)
    }

    /// Takes the text of a file of several machines; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// With file, line and key what is wrong.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputError> {
        Document::new(file, text).decode(|root| Self::decode(&root, file, folder))
    }

    /// The machine of this name.
    ///
    /// # Errors
    /// There is none; the names that there are.
    pub fn machine(&self, name: &str) -> Result<&MachineEntry, GatewayError> {
        let mut machines = self.machines.iter();
        let found = machines.find(|machine| machine.name == name);
        found.ok_or_else(|| GatewayError::NoSuchMachine {
            file: self.file.clone(),
            found: name.to_owned(),
            expected: self.names(),
        })
    }

    /// The names of the machines in one line.
    pub fn names(&self) -> String {
        let names: Vec<&str> = self.machines.iter().map(|m| m.name.as_str()).collect();
        names.join(", ")
    }

    fn decode(root: &Section<'_>, file: &str, folder: &Path) -> Result<Self, InputError> {
        let own = ["machine", "dashboard"];
        if let Some((key, value)) = root
            .values()
            .find(|(key, _)| ROOT_KEYS.contains(key) && !own.contains(key))
        {
            return Err(value.error(format!(
                "found `{key}` beside [[machine]], expected it in the configuration of a machine, which `config` names"
            )));
        }
        root.allow(&own)?;
        let mut machines: Vec<MachineEntry> = Vec::new();
        root.tables("machine", |table| {
            let entry = entry(table, folder)?;
            // Names are folders, too, and some file systems do not tell upper from lower case.
            let is_same = |before: &&MachineEntry| before.name.eq_ignore_ascii_case(&entry.name);
            if let Some(before) = machines.iter().find(is_same) {
                return Err(table.require("name")?.error(format!(
                    "found {:?} beside {:?}, expected another name for each machine",
                    entry.name, before.name
                )));
            }
            machines.push(entry);
            Ok(())
        })?;
        if machines.is_empty() || machines.len() > MOST {
            return Err(root.error(format!(
                "found {} [[machine]], expected 1 to {MOST}",
                machines.len()
            )));
        }
        Ok(Self {
            file: file.to_owned(),
            machines,
            dashboard: root
                .section("dashboard")?
                .map(|section| dashboard(&section, folder))
                .transpose()?
                .unwrap_or_default(),
        })
    }
}

/// Whether a file is that of several machines: in the configuration of one, `machine` is a text.
pub(super) fn holds_several(root: &Section<'_>) -> bool {
    root.get("machine")
        .is_some_and(|value| value.items().is_ok())
}

fn entry(table: &Section<'_>, folder: &Path) -> Result<MachineEntry, InputError> {
    table.allow(&["name", "config"])?;
    let name = table.require("name")?;
    let text = name.text()?;
    if !is_name(text) {
        return Err(name.error(format!(
            "found {text:?}, expected 1 to {LONGEST_NAME} letters (a to z), digits, -, _ and dots, none of these first"
        )));
    }
    let config = table.require("config")?;
    match config.text()? {
        "" => Err(config.error("found an empty text, expected the path of a configuration")),
        path => Ok(MachineEntry {
            name: text.to_owned(),
            config: folder.join(path),
        }),
    }
}

/// Whether a name can be a folder, a word of a command line and a word of a log.
fn is_name(text: &str) -> bool {
    let within = text
        .bytes()
        .all(|byte| byte.is_ascii_alphanumeric() || b"-_.".contains(&byte));
    within
        && text.len() <= LONGEST_NAME
        && text
            .bytes()
            .next()
            .is_some_and(|byte| byte.is_ascii_alphanumeric())
}
