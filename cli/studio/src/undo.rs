//! Reverts the last change of the folder that came from the web page. The earlier contents are kept in memory only.

use std::{
    fs,
    path::PathBuf,
    time::{SystemTime, UNIX_EPOCH},
};

use serde::Serialize;
use sha2::{Digest as _, Sha256};
use volcomp_model::{hexadecimal, sha256_of};

use crate::{
    error::StudioError,
    folder::{
        ANSWERS, CALIBRATION, FITTED, Folder, INPUTS, MACHINE, MACHINE_BACKUP, PROGRAMS, REPORT,
        RESULT, SETUP, TABLES,
    },
};

/// Every file that a change may write, except an uploaded file.
const WRITTEN: [&str; 8] =
    [MACHINE, MACHINE_BACKUP, SETUP, ANSWERS, CALIBRATION, FITTED, REPORT, INPUTS];

/// The contents of the files before a change.
pub(crate) struct Snapshot {
    files: Vec<(String, Option<Vec<u8>>)>,
    /// Folder to which the change would move the previous result.
    aside: PathBuf,
}

/// A change that can be reverted.
#[derive(Debug)]
pub(crate) struct Change {
    pub(crate) name: ChangeName,
    /// Number of the drop to which the change belongs; files of one drop are reverted together.
    batch: Option<u64>,
    files: Vec<ChangedFile>,
    /// Folder to which the change moved the previous result; `None` if it moved nothing.
    aside: Option<PathBuf>,
}

/// A change as the web page names it.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct ChangeName {
    /// What was changed, such as `answers` or `file exx.csv`.
    what: String,
    /// Time of the change, seconds since 1970 (UTC).
    at_s: u64,
}

#[derive(Debug)]
struct ChangedFile {
    name: String,
    before: Option<Vec<u8>>,
    /// SHA-256 after the change; `None` if the change removed the file.
    after: Option<String>,
}

impl Change {
    /// True if the change is a fit, from which tables and programs are written.
    pub(crate) fn is_fit(&self) -> bool {
        let is_result = |file: &ChangedFile| file.name == FITTED || file.name == REPORT;
        self.aside.is_some() || self.files.iter().any(is_result)
    }

    /// Joins the change with the previous one if both belong to one drop of files.
    pub(crate) fn after(mut self, previous: Option<Self>) -> Self {
        let Some(previous) = previous.filter(|of| of.batch.is_some() && of.batch == self.batch)
        else {
            return self;
        };
        for earlier in previous.files {
            match self.files.iter_mut().find(|file| file.name == earlier.name) {
                Some(file) => file.before = earlier.before,
                None => self.files.push(earlier),
            }
        }
        let uploaded = self.files.iter().filter(|file| file.name != MACHINE_BACKUP);
        self.name.what = format!("{} files", uploaded.count());
        self
    }
}

impl Folder {
    /// Reads the files that a change may write, including an uploaded file.
    pub(crate) fn snapshot(&self, uploaded: Option<&str>) -> Snapshot {
        let mut names: Vec<&str> = WRITTEN.to_vec();
        names.extend(uploaded.filter(|name| !WRITTEN.contains(name)));
        let read = |name: &str| (name.to_owned(), fs::read(self.at(name)).ok());
        Snapshot { files: names.into_iter().map(read).collect(), aside: self.next_aside() }
    }

    /// Returns what has changed since `before`; `None` if nothing has changed.
    pub(crate) fn change_since(
        &self,
        before: Snapshot,
        what: String,
        batch: Option<u64>,
    ) -> Option<Change> {
        let files = before.files.into_iter().filter_map(|(name, before)| {
            let now = fs::read(self.at(&name)).ok();
            let after = || now.as_deref().map(|now| hexadecimal(&Sha256::digest(now)));
            (now != before).then(|| ChangedFile { name, after: after(), before })
        });
        let files: Vec<ChangedFile> = files.collect();
        let aside = Some(before.aside).filter(|aside| aside.exists());
        if files.is_empty() && aside.is_none() {
            return None;
        }
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Some(Change { name: ChangeName { what, at_s: since.as_secs() }, batch, files, aside })
    }

    /// The tables or programs that were written from this fit. A fit with such outputs is not reverted.
    pub(crate) fn output_of(&self, change: &Change) -> Option<&'static str> {
        [TABLES, PROGRAMS].into_iter().find(|name| change.is_fit() && self.at(name).exists())
    }

    /// Restores the contents before a change.
    ///
    /// # Errors
    /// Another program has changed a file since, or outputs of the fit exist. Then nothing is reverted.
    pub(crate) fn revert(&self, change: &Change) -> Result<(), StudioError> {
        for file in &change.files {
            if sha256_of(&self.at(&file.name)).ok() != file.after {
                let why = "was changed since by another program, so the change is not reverted";
                return Err(StudioError::Upload { name: file.name.clone(), why: why.to_owned() });
            }
        }
        if let Some(name) = self.output_of(change) {
            let why = "was written from this fit, which is therefore not reverted";
            return Err(StudioError::Upload { name: name.to_owned(), why: why.to_owned() });
        }
        self.interrupt.check()?;
        if let Some(aside) = &change.aside {
            // Moving the previous machine file keeps its date.
            let moved = || {
                for entry in fs::read_dir(aside)? {
                    let entry = entry?;
                    fs::rename(entry.path(), self.at(RESULT).join(entry.file_name()))?;
                }
                fs::remove_dir(aside)
            };
            moved().map_err(StudioError::disk(aside.display()))?;
        }
        for file in &change.files {
            let path = self.at(&file.name);
            match &file.before {
                Some(before) if fs::read(&path).ok().as_ref() != Some(before) => {
                    self.write(&file.name, before)?;
                }
                Some(_) => {}
                None => fs::remove_file(&path).map_err(StudioError::disk(&file.name))?,
            }
        }
        Ok(())
    }
}
