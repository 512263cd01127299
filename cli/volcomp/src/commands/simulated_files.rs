//! The list of files that `volcomp simulate` wrote into a folder, so that it writes over no other.

use std::{collections::BTreeMap, fmt::Write, path::Path};

use sha2::{Digest, Sha256};

use super::write_file;
use crate::failure::Failure;

/// No file of a shop has this name: those of measurements and observations have other endings.
const NAME: &str = "simulated-files.sha256";
/// The first line tells that the list itself was not written by somebody else.
const FIRST_LINE: &str = "# Written by volcomp simulate, which writes over these files while they are as listed here: SHA-256 and name";

/// The files of earlier runs with the SHA-256 of what was written into them, as `sha256sum` lists them.
pub(super) struct List(BTreeMap<String, String>);

impl List {
    /// Reads the list in a folder; it is empty where there is none.
    pub(super) fn read(folder: &Path) -> Result<Self, Failure> {
        let path = folder.join(NAME);
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

    /// Refuses to write a text over a file that is there, unless it is as it was written by an earlier run, or nothing is lost.
    pub(super) fn refuse_others(
        &self,
        folder: &Path,
        name: &str,
        text: &str,
    ) -> Result<(), Failure> {
        let path = folder.join(name);
        let Some(found) = content(&path)? else {
            return Ok(());
        };
        let is_listed = || self.0.get(name) == Some(&digest(&found));
        if found == text.as_bytes() || is_listed() {
            return Ok(());
        }
        Err(not_mine(&path))
    }

    /// Adds a file that was written.
    pub(super) fn add(&mut self, name: &str, text: &str) {
        self.0.insert(name.to_owned(), digest(text.as_bytes()));
    }

    pub(super) fn write(&self, folder: &Path) -> Result<(), Failure> {
        let mut text = format!("{FIRST_LINE}\n");
        for (name, digest) in &self.0 {
            // Writing to a String cannot fail.
            let _ = writeln!(text, "{digest}  {name}");
        }
        write_file(&folder.join(NAME), &text)
    }
}

/// Writes files into a folder that is there and into its list, unless one of them is somebody else's.
pub(super) fn write_listed(folder: &Path, files: &[(&str, &str)]) -> Result<(), Failure> {
    let mut list = List::read(folder)?;
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

/// The bytes of a file, if it is there.
fn content(path: &Path) -> Result<Option<Vec<u8>>, Failure> {
    if !path.exists() {
        return Ok(None);
    }
    let read = std::fs::read(path);
    read.map(Some).map_err(|e| Failure::in_file(path, e))
}

fn digest(bytes: &[u8]) -> String {
    let digest = Sha256::digest(bytes);
    digest.iter().fold(String::new(), |mut text, byte| {
        // Writing to a String cannot fail.
        let _ = write!(text, "{byte:02x}");
        text
    })
}
