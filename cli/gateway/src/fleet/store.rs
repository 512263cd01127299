//! The folder in which a machine keeps what it has accepted: the newest manifest, the one in force, and their machine files.
//!
//! `standing.json` says which is which and is replaced whole. Manifests are kept as they were signed, so that nothing in the
//! folder is believed that a trusted key has not signed; a machine file is known by its checksum. The manifest is on disk before
//! its version counts, and its version before anything is done by it.

use std::{
    collections::BTreeSet,
    fs, io,
    os::unix::fs::DirBuilderExt,
    path::{Path, PathBuf},
};

use serde::{Deserialize, Serialize};
use volcomp_fleet::{Desired, MachineId, Manifest, Outcome, Trust};

use crate::{audit::replace_file, config::FleetConfig};

const STANDING: &str = "standing.json";

/// What outlives a restart, besides the manifests.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Standing {
    /// The version of the highest manifest that was accepted; 0: none was.
    pub(crate) highest: u64,
    /// The version of the manifest in force; `None`: the configured machine file corrects.
    pub(crate) active: Option<u64>,
    /// Whether the centre forbids correcting.
    pub(crate) disabled: bool,
    /// What became of the highest one; `None`: that is not known yet.
    pub(crate) outcome: Option<Outcome>,
}

/// A manifest that a trusted key signed for this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Held {
    /// The document, without its machine file.
    pub(crate) desired: Desired,
    /// What it says.
    pub(crate) manifest: Manifest,
}

/// What the folder holds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Kept {
    pub(crate) standing: Standing,
    /// The highest manifest that was accepted.
    pub(crate) newest: Option<Held>,
    /// The one in force, whose machine file is there and whole.
    pub(crate) active: Option<Held>,
    /// What is damaged, in words.
    pub(crate) damage: Option<String>,
}

/// The folder.
#[derive(Clone, Debug)]
pub(crate) struct Store {
    dir: PathBuf,
}

impl Store {
    pub(crate) fn new(config: &FleetConfig) -> Self {
        Self {
            dir: config.dir.clone(),
        }
    }

    /// The folder of messages that wait for the server.
    pub(crate) fn spool(&self) -> PathBuf {
        self.dir.join("waiting")
    }

    /// The file that says how far the audit log has been sent.
    pub(crate) fn audit_cursor(&self) -> PathBuf {
        self.dir.join("audit-sent.json")
    }

    /// The machine file of a manifest.
    pub(crate) fn machine(&self, manifest: &Manifest) -> PathBuf {
        self.dir
            .join(format!("machine-{}.toml", manifest.model.sha256))
    }

    fn manifest(&self, version: u64) -> PathBuf {
        self.dir.join(format!("manifest-{version}.json"))
    }

    /// Makes the folder, for this user alone.
    pub(crate) fn make(&self) -> io::Result<()> {
        let mut builder = fs::DirBuilder::new();
        builder.recursive(true).mode(0o700).create(&self.dir)
    }

    /// Reads the folder, and believes of it what a trusted key has signed for this machine. A folder that is not there holds
    /// nothing.
    pub(crate) fn read(&self, config: &FleetConfig) -> Kept {
        let mut kept = Kept::default();
        let mut damage = Vec::new();
        match read_standing(&self.dir.join(STANDING)) {
            Ok(standing) => kept.standing = standing.unwrap_or_default(),
            Err(error) => {
                damage.push(error);
                // Whether the centre allows it is not known: what is unknown forbids.
                kept.standing.disabled = true;
            }
        }
        let manifests = self.manifests(config);
        let newest = manifests.iter().max_by_key(|held| held.manifest.version);
        if let Some(newest) = newest
            && (newest.manifest.version > kept.standing.highest || !damage.is_empty())
        {
            // Its version was not written down any more, or it is all that is left.
            kept.standing.highest = newest.manifest.version;
            kept.standing.disabled =
                !newest.manifest.enable || (kept.standing.disabled && damage.is_empty());
            kept.standing.outcome = None;
        }
        let with = |version: u64| {
            let mut all = manifests.iter();
            all.find(|held| held.manifest.version == version).cloned()
        };
        kept.newest = with(kept.standing.highest);
        if let Some(version) = kept.standing.active {
            match with(version) {
                None => damage.push(format!(
                    "{}: the manifest in force is missing, or no trusted key has signed it for this machine",
                    self.manifest(version).display()
                )),
                Some(held) if !self.has_machine(&held.manifest) => damage.push(format!(
                    "{}: it does not fit the checksum of its manifest",
                    self.machine(&held.manifest).display()
                )),
                Some(held) => kept.active = Some(held),
            }
            if kept.active.is_none() {
                kept.standing.active = None;
                // Where it was the newest, it is fetched again.
                if version == kept.standing.highest {
                    kept.standing.outcome = None;
                }
            }
        }
        kept.damage = (!damage.is_empty()).then(|| damage.join("; "));
        kept
    }

    /// The manifests that a trusted key has signed for this machine.
    fn manifests(&self, config: &FleetConfig) -> Vec<Held> {
        let Ok(entries) = fs::read_dir(&self.dir) else {
            return Vec::new();
        };
        let paths = entries.filter_map(|entry| Some(entry.ok()?.path()));
        let named = paths.filter(|path| {
            let name = path.file_name().and_then(|name| name.to_str());
            name.is_some_and(|name| name.starts_with("manifest-"))
                && path.extension().is_some_and(|ending| ending == "json")
        });
        named.filter_map(|path| verified(&path, config)).collect()
    }

    /// Whether the machine file of a manifest is there and whole.
    pub(crate) fn has_machine(&self, manifest: &Manifest) -> bool {
        fs::read(self.machine(manifest)).is_ok_and(|text| manifest.model.is(&text))
    }

    /// Keeps an accepted manifest and what stands from now on, in this order.
    pub(crate) fn keep(&self, held: &Held, standing: &Standing) -> io::Result<()> {
        self.make()?;
        let text = serde_json::to_string(&held.desired)?;
        replace_file(&self.manifest(held.manifest.version), &text)?;
        self.keep_standing(standing)
    }

    /// Keeps the machine file of a manifest.
    pub(crate) fn keep_machine(&self, manifest: &Manifest, text: &str) -> io::Result<()> {
        replace_file(&self.machine(manifest), text)
    }

    /// Writes down what stands from now on.
    pub(crate) fn keep_standing(&self, standing: &Standing) -> io::Result<()> {
        replace_file(&self.dir.join(STANDING), &serde_json::to_string(standing)?)
    }

    /// Removes what belongs to neither of these manifests.
    pub(crate) fn tidy(&self, held: &[&Held]) {
        let needed: BTreeSet<PathBuf> = held
            .iter()
            .flat_map(|held| {
                [
                    self.manifest(held.manifest.version),
                    self.machine(&held.manifest),
                ]
            })
            .collect();
        let Ok(entries) = fs::read_dir(&self.dir) else {
            return;
        };
        for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
            let name = path.file_name().and_then(|name| name.to_str());
            let is_ours = name
                .is_some_and(|name| name.starts_with("manifest-") || name.starts_with("machine-"));
            if is_ours && !needed.contains(&path) {
                // One that stays takes room and does nothing else.
                let _ = fs::remove_file(path);
            }
        }
    }
}

fn read_standing(path: &Path) -> Result<Option<Standing>, String> {
    match fs::read_to_string(path) {
        Ok(text) => serde_json::from_str(&text)
            .map(Some)
            .map_err(|e| format!("{}: {e}", path.display())),
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(format!("{}: {e}", path.display())),
    }
}

/// A manifest on disk that a trusted key has signed for this machine. Its axes are compared with the machine when it is put
/// in force, and its machine file with its checksum.
fn verified(path: &Path, config: &FleetConfig) -> Option<Held> {
    let desired = Desired::parse(&fs::read(path).ok()?).ok()?;
    let manifest: Manifest = serde_json::from_str(&desired.manifest).ok()?;
    let trust = Trust {
        axes: manifest.axes,
        ..trust(config, config.identity().ok()?.machine)
    };
    let accepted = trust.accept(&desired).ok()?;
    Some(Held {
        desired,
        manifest: accepted.manifest,
    })
}

/// What a machine trusts, without its axes.
pub(crate) fn trust(config: &FleetConfig, machine: MachineId) -> Trust {
    Trust {
        keys: config.trusted(),
        machine,
        serial: config.serial.clone(),
        axes: Vec::new(),
        highest: 0,
    }
}
