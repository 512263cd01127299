//! The folder of stored models: `models` in the folder of the audit log.
//!
//! `standing.json` records the model activated by an operator and the history, and is replaced atomically. Machine
//! files are named by their hash, which is verified on reading. A machine file is on disk before its model is
//! activated.

use std::{
    collections::BTreeSet,
    fs, io,
    os::unix::fs::DirBuilderExt,
    path::{Path, PathBuf},
};

use rustix::fs::statvfs;
use volcomp_model::Machine;

use crate::{
    audit::replace_file,
    documents::{ModelEntry, ModelOutcome, ModelsKept},
};

const STANDING: &str = "standing.json";
/// Maximum number of history entries. Only the models of these entries are kept.
pub(crate) const MAX_HISTORY: usize = 100;

/// Disk space reserved for the audit log, bytes. The gateway does not arm if it cannot write the log.
const RESERVE: u64 = 64 * 1024 * 1024;

#[derive(Clone, Debug)]
pub(crate) struct Store {
    dir: PathBuf,
}

impl Store {
    pub(crate) fn new(audit_dir: &Path) -> Self {
        Self { dir: audit_dir.join("models") }
    }

    pub(crate) fn machine(&self, hash: &str) -> PathBuf {
        // The hash comes from a client and must not act as a path.
        let hash = hash.strip_prefix("sha256:").unwrap_or(hash);
        let digits: String = hash.chars().filter(char::is_ascii_hexdigit).collect();
        self.dir.join(format!("machine-{digits}.toml"))
    }

    pub(crate) fn holds(&self, machine: &Path) -> bool {
        machine.parent() == Some(&self.dir)
    }

    /// The stored state, and a description of any damage. A missing folder counts as empty.
    pub(crate) fn read(&self) -> (ModelsKept, Option<String>) {
        let path = self.dir.join(STANDING);
        let damaged = |error: String| {
            let what = format!(
                "{}: {error}: the model that an operator activated is unknown",
                path.display()
            );
            (ModelsKept::default(), Some(what))
        };
        match fs::read_to_string(&path) {
            Ok(text) => match serde_json::from_str::<ModelsKept>(&text) {
                Ok(kept) => (kept, None),
                Err(e) => damaged(e.to_string()),
            },
            Err(e) if is_missing(&e) => Default::default(),
            Err(e) => damaged(e.to_string()),
        }
    }

    /// Moves the folder aside if its state is damaged. Saving a new state removes all machine files that it does not
    /// reference, and the new state references none of the earlier ones.
    pub(crate) fn set_aside(&self) -> io::Result<()> {
        let mut aside = (1..1000).map(|n| self.dir.with_file_name(format!("models.damaged-{n}")));
        let aside = aside.find(|aside| !aside.exists());
        let aside = aside.ok_or(io::ErrorKind::AlreadyExists)?;
        fs::rename(&self.dir, &aside)?;
        tracing::error!("models: the damaged folder is now {}", aside.display());
        Ok(())
    }

    /// Path of the machine file activated by an operator; `None` if the operator activated none. `Err` describes a
    /// missing or damaged file.
    pub(crate) fn in_force(&self) -> Result<Option<PathBuf>, String> {
        let (kept, damage) = self.read();
        if let Some(damage) = damage {
            return Err(damage);
        }
        let Some(in_force) = kept.in_force else {
            return Ok(None);
        };
        self.text(&in_force.hash)?;
        Ok(Some(self.machine(&in_force.hash)))
    }

    /// Text of a stored model. The text is verified against the hash.
    pub(crate) fn text(&self, hash: &str) -> Result<String, String> {
        let path = self.machine(hash);
        let wrong = |what: String| format!("{}: {what}", path.display());
        let text = fs::read_to_string(&path).map_err(|e| wrong(e.to_string()))?;
        let machine = Machine::parse(&text, &path.display().to_string());
        match machine {
            Ok(machine) if machine.checksum() == hash => Ok(text),
            Ok(machine) => {
                Err(wrong(format!("its hash is {}, expected {hash}", machine.checksum())))
            }
            Err(e) => Err(e.to_string()),
        }
    }

    fn make(&self) -> io::Result<()> {
        let mut builder = fs::DirBuilder::new();
        builder.recursive(true).mode(0o700).create(&self.dir)
    }

    /// Stores a machine file if [`RESERVE`] bytes remain free afterwards.
    pub(crate) fn keep(&self, hash: &str, text: &str) -> io::Result<()> {
        self.make()?;
        if self.text(hash).is_ok() {
            return Ok(());
        }
        check_room(&self.dir, text.len() as u64)?;
        replace_file(&self.machine(hash), text)
    }

    /// Saves the state, and removes machine files that it no longer references.
    pub(crate) fn keep_standing(&self, kept: &ModelsKept) -> io::Result<()> {
        self.make()?;
        replace_file(&self.dir.join(STANDING), &serde_json::to_string(kept)?)?;
        self.tidy(kept);
        Ok(())
    }

    fn tidy(&self, kept: &ModelsKept) {
        let needed: BTreeSet<PathBuf> = hashes(kept).map(|hash| self.machine(hash)).collect();
        let Ok(entries) = fs::read_dir(&self.dir) else {
            return;
        };
        for path in entries.filter_map(|entry| Some(entry.ok()?.path())) {
            let name = path.file_name().and_then(|name| name.to_str());
            let is_ours = name.is_some_and(|name| name.starts_with("machine-"));
            if is_ours && !needed.contains(&path) {
                // A file that cannot be removed only uses space.
                let _ = fs::remove_file(path);
            }
        }
    }

    /// Hashes of the models in `kept` whose files exist, newest first, without duplicates.
    pub(crate) fn stored_hashes(&self, kept: &ModelsKept) -> Vec<String> {
        let mut seen = BTreeSet::new();
        let all = hashes(kept).filter(|hash| seen.insert(hash.to_owned()));
        let stored = all.filter(|hash| self.machine(hash).is_file());
        let mut stored: Vec<String> = stored.map(str::to_owned).collect();
        stored.reverse();
        stored
    }
}

/// Hashes of all models that were active and of the active model, with duplicates.
fn hashes(kept: &ModelsKept) -> impl Iterator<Item = &str> {
    let was = |entry: &&ModelEntry| entry.outcome == ModelOutcome::InForce;
    let history = kept.history.iter().filter(was);
    let history = history.map(|entry| entry.hash.as_str());
    history.chain(kept.in_force.iter().map(|model| model.hash.as_str()))
}

/// True if the file does not exist. Opening the audit log reports other errors of the folder.
fn is_missing(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::NotFound
            | io::ErrorKind::NotADirectory
            | io::ErrorKind::InvalidInput
            | io::ErrorKind::InvalidFilename
    )
}

/// Appends a history entry, and drops the oldest entries beyond [`MAX_HISTORY`].
pub(crate) fn add(kept: &mut ModelsKept, entry: ModelEntry) {
    kept.history.push(entry);
    let more = kept.history.len().saturating_sub(MAX_HISTORY);
    kept.history.drain(..more);
}

/// Rejects a file that would use the space reserved for the audit log.
fn check_room(folder: &Path, bytes: u64) -> io::Result<()> {
    // If the file system does not report its free space, allow the write.
    let Ok(disk) = statvfs(folder) else {
        return Ok(());
    };
    let free = disk.f_bavail.saturating_mul(disk.f_frsize);
    if free >= bytes.saturating_add(RESERVE) {
        return Ok(());
    }
    let mib = RESERVE / 1024 / 1024;
    let why =
        format!("the disk is full: less than {mib} MiB would stay free, which the audit log needs");
    Err(io::Error::new(io::ErrorKind::StorageFull, why))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::documents::{ModelInForce, ModelSource};

    const TEXT: &str =
        "structure = \"w X' b t\"\naxes.X.travel = [0.0, 100.0]\n[errors]\nEYX = 20.0\n";

    fn canonical() -> (String, String) {
        let machine = Machine::parse(TEXT, "m").expect("right");
        (machine.checksum(), machine.to_toml())
    }

    fn entry(hash: &str) -> ModelEntry {
        ModelEntry {
            time: "2026-01-01T00:00:00.000Z".to_owned(),
            who: "erna".to_owned(),
            hash: hash.to_owned(),
            name: String::new(),
            from: ModelSource::Upload,
            file: "m.toml".to_owned(),
            outcome: ModelOutcome::InForce,
            why: None,
            worst_um: Some(1.0),
            worst_urad: None,
        }
    }

    fn standing(hash: &str) -> ModelsKept {
        ModelsKept {
            in_force: Some(ModelInForce {
                hash: hash.to_owned(),
                who: "erna".to_owned(),
                time: String::new(),
                file: "m.toml".to_owned(),
            }),
            history: vec![entry(hash)],
        }
    }

    /// Covers every state that a kill between two steps of an activation can leave on disk. The loaded model is
    /// complete, and is the new one only after its activation was stored.
    #[test]
    fn a_kill_between_two_steps_leaves_a_model_that_is_whole() {
        let dir = tempfile::tempdir().expect("writable");
        let store = Store::new(dir.path());
        let (hash, text) = canonical();
        assert_eq!(store.in_force(), Ok(None), "nothing is stored");
        store.make().expect("writable");
        // The machine file is half written.
        let machine = store.machine(&hash);
        fs::write(machine.with_extension("new"), &text[..20]).expect("writable");
        assert_eq!(store.in_force(), Ok(None));
        // The machine file is complete.
        store.keep(&hash, &text).expect("writable");
        assert_eq!(store.in_force(), Ok(None));
        // The activation is half written.
        let whole = serde_json::to_string(&standing(&hash)).expect("JSON");
        fs::write(dir.path().join("models/standing.new"), &whole[..30]).expect("writable");
        assert_eq!(store.in_force(), Ok(None));
        // The activation is stored.
        store.keep_standing(&standing(&hash)).expect("writable");
        assert_eq!(store.in_force(), Ok(Some(machine.clone())));
        // A file damaged later is not loaded, and the damage is reported.
        fs::write(&machine, text.replace("20.0", "90.0")).expect("writable");
        assert!(store.in_force().is_err());
        fs::write(&machine, "").expect("writable");
        assert!(store.in_force().is_err());
        fs::remove_file(&machine).expect("ours");
        assert!(store.in_force().is_err());
    }

    #[test]
    fn the_history_is_bounded_and_files_without_a_line_go() {
        let dir = tempfile::tempdir().expect("writable");
        let store = Store::new(dir.path());
        let (hash, text) = canonical();
        store.keep(&hash, &text).expect("writable");
        let mut kept = ModelsKept::default();
        add(&mut kept, entry(&hash));
        store.keep_standing(&kept).expect("writable");
        assert!(store.text(&hash).is_ok());
        for number in 0..MAX_HISTORY {
            add(&mut kept, entry(&format!("sha256:{number:064x}")));
        }
        assert_eq!(kept.history.len(), MAX_HISTORY);
        store.keep_standing(&kept).expect("writable");
        assert!(store.text(&hash).is_err(), "its entry is gone, and the file with it");
    }

    #[test]
    fn a_hash_from_outside_is_no_path() {
        let store = Store::new(Path::new("/a"));
        assert_eq!(store.machine("../../etc/passwd"), Path::new("/a/models/machine-ecad.toml"));
    }
}
