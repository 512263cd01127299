//! The folder of accepted manifests: the newest one, the active one, and their machine files.
//!
//! `standing.json` records the versions of the newest and the active manifest, and is replaced atomically. Manifests
//! are stored as signed, so that only content signed by a trusted key is used; a machine file is identified by its
//! checksum. A manifest is on disk before its version counts, and the version is on disk before it has any effect.

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

/// State that survives a restart, beyond the manifests.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Standing {
    /// Highest accepted version of a manifest; 0: none.
    pub(crate) highest: u64,
    /// Version of the active manifest; `None`: the configured machine file is active.
    pub(crate) active: Option<u64>,
    pub(crate) disabled: bool,
    /// Outcome of the manifest with the version `highest`; `None`: not known yet.
    pub(crate) outcome: Option<Outcome>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct StoredManifest {
    pub(crate) desired: Desired,
    pub(crate) manifest: Manifest,
}

#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct StoredFleet {
    pub(crate) standing: Standing,
    pub(crate) newest: Option<StoredManifest>,
    pub(crate) active: Option<StoredManifest>,
    pub(crate) damage: Option<String>,
}

#[derive(Clone, Debug)]
pub(crate) struct Store {
    dir: PathBuf,
    /// Site and name of the machine.
    identity: String,
}

impl Store {
    pub(crate) fn new(config: &FleetConfig) -> Self {
        let identity = format!("{}.{}", config.site, config.machine);
        Self { dir: config.dir.clone(), identity }
    }

    /// The folder of messages that wait for the server. Each identity has its own folder: the messages do not name
    /// their machine, and the computer may later serve another machine.
    pub(crate) fn spool(&self) -> PathBuf {
        self.dir.join("waiting").join(&self.identity)
    }

    pub(crate) fn audit_cursor(&self) -> PathBuf {
        self.dir.join("audit-sent.json")
    }

    pub(crate) fn machine(&self, manifest: &Manifest) -> PathBuf {
        self.dir.join(format!("machine-{}.toml", manifest.model.sha256))
    }

    fn manifest(&self, version: u64) -> PathBuf {
        self.dir.join(format!("manifest-{version}.json"))
    }

    pub(crate) fn make(&self) -> io::Result<()> {
        let mut builder = fs::DirBuilder::new();
        builder.recursive(true).mode(0o700).create(&self.dir)
    }

    /// Reads the folder. Only content signed by a trusted key for this machine is used. A missing folder is treated as
    /// empty.
    pub(crate) fn read(&self, config: &FleetConfig) -> StoredFleet {
        let mut kept = StoredFleet::default();
        let mut damage = Vec::new();
        match read_standing(&self.dir.join(STANDING)) {
            Ok(standing) => kept.standing = standing.unwrap_or_default(),
            Err(error) => {
                damage.push(error);
                // It is unknown whether the centre permits correcting, so correcting is forbidden.
                kept.standing.disabled = true;
            }
        }
        let manifests = self.manifests(config);
        let newest = manifests.iter().max_by_key(|held| held.manifest.version);
        if let Some(newest) = newest
            && (newest.manifest.version > kept.standing.highest || !damage.is_empty())
        {
            // The gateway stopped before it saved the version, or `standing.json` is damaged.
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
                    "{}: the active manifest is missing, or no trusted key has signed it for this machine",
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
                // The newest manifest is received again, so its outcome is open.
                if version == kept.standing.highest {
                    kept.standing.outcome = None;
                }
            }
        }
        kept.damage = (!damage.is_empty()).then(|| damage.join("; "));
        kept
    }

    fn manifests(&self, config: &FleetConfig) -> Vec<StoredManifest> {
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

    pub(crate) fn has_machine(&self, manifest: &Manifest) -> bool {
        fs::read(self.machine(manifest)).is_ok_and(|text| manifest.model.is(&text))
    }

    /// Saves an accepted manifest, then the new standing; the order matters.
    pub(crate) fn keep(&self, held: &StoredManifest, standing: &Standing) -> io::Result<()> {
        self.make()?;
        let text = serde_json::to_string(&held.desired)?;
        replace_file(&self.manifest(held.manifest.version), &text)?;
        self.keep_standing(standing)
    }

    pub(crate) fn keep_machine(&self, manifest: &Manifest, text: &str) -> io::Result<()> {
        replace_file(&self.machine(manifest), text)
    }

    pub(crate) fn keep_standing(&self, standing: &Standing) -> io::Result<()> {
        replace_file(&self.dir.join(STANDING), &serde_json::to_string(standing)?)
    }

    pub(crate) fn tidy(&self, held: &[&StoredManifest]) {
        let needed: BTreeSet<PathBuf> = held
            .iter()
            .flat_map(|held| [self.manifest(held.manifest.version), self.machine(&held.manifest)])
            .collect();
        let Ok(entries) = fs::read_dir(&self.dir) else {
            return;
        };
        for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
            let name = path.file_name().and_then(|name| name.to_str());
            let is_ours = name
                .is_some_and(|name| name.starts_with("manifest-") || name.starts_with("machine-"));
            if is_ours && !needed.contains(&path) {
                // A file that cannot be removed only uses space.
                let _ = fs::remove_file(path);
            }
        }
    }
}

fn read_standing(path: &Path) -> Result<Option<Standing>, String> {
    match fs::read_to_string(path) {
        Ok(text) => {
            serde_json::from_str(&text).map(Some).map_err(|e| format!("{}: {e}", path.display()))
        }
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(e) => Err(format!("{}: {e}", path.display())),
    }
}

/// Reads a manifest that a trusted key signed for this machine. Its axes are compared with the machine at activation,
/// and its machine file with the checksum.
fn verified(path: &Path, config: &FleetConfig) -> Option<StoredManifest> {
    let desired = Desired::parse(&fs::read(path).ok()?).ok()?;
    let manifest: Manifest = serde_json::from_str(&desired.manifest).ok()?;
    let trust = Trust { axes: manifest.axes, ..trust(config, config.identity().ok()?.machine) };
    let accepted = trust.accept(&desired).ok()?;
    Some(StoredManifest { desired, manifest: accepted.manifest })
}

/// Keys and identity that the machine trusts, without its axes.
pub(crate) fn trust(config: &FleetConfig, machine: MachineId) -> Trust {
    Trust {
        keys: config.trusted(),
        machine,
        serial: config.serial.clone(),
        axes: Vec::new(),
        highest: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_waits_is_not_sent_as_another_machines() {
        let spool = |machine: &str| {
            let config = FleetConfig { machine: machine.to_owned(), ..FleetConfig::default() };
            Store::new(&config).spool()
        };
        assert_ne!(spool("mill-1"), spool("mill-2"));
    }
}
