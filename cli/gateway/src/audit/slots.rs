//! A file that can be updated on a full disk: it is allocated once and then overwritten in place.
//!
//! Two slots of equal size are written alternately, each with a checksum and a counter. A power failure during a write
//! leaves the previous text in the other slot.

use std::{
    fs::{self, File, OpenOptions},
    io,
    os::unix::fs::FileExt,
    path::PathBuf,
};

use sha2::{Digest, Sha256};

use super::{is_at, replace_file, restore_folder};

/// Size of a slot, bytes; larger than the longest text.
const SLOT: usize = 16 * 1024;
const SLOTS: u64 = 2;

/// A file with two slots. The file is created by the first [`keep`](Self::keep).
pub(crate) struct Slots {
    path: PathBuf,
    open: Option<Open>,
}

struct Open {
    file: File,
    count: u64,
}

impl Slots {
    pub(crate) fn new(path: PathBuf) -> Self {
        Self { path, open: None }
    }

    /// Writes a text and syncs it to disk. The first call allocates the file. Errors: the text is too long, the disk
    /// fails, or the disk is full before the file is allocated.
    pub(crate) fn keep(&mut self, text: &str) -> io::Result<()> {
        let mut open = match self.open.take() {
            // The file may have been removed or replaced.
            Some(open) if self.is_in_place(&open.file) => open,
            before => {
                if let (Some(dir), Some(before)) = (self.path.parent(), before) {
                    restore_folder(dir, &before.file)?;
                }
                self.take_room(text)?
            }
        };
        let count = open.count + 1;
        let slot = slot(count, text)?;
        let written = (open.file)
            .write_all_at(slot.as_bytes(), (count % SLOTS) * SLOT as u64)
            .and_then(|()| open.file.sync_data());
        // After a failed write the next call writes the same slot again, because the other slot holds the last intact
        // text.
        if written.is_ok() {
            open.count = count;
        }
        self.open = Some(open);
        written
    }

    fn is_in_place(&self, file: &File) -> bool {
        let length = file.metadata().map(|of| of.len());
        is_at(file, &self.path) && length.is_ok_and(|length| length == SLOTS * SLOT as u64)
    }

    /// Opens the file. If the file is missing or has another size, it is created completely under a temporary name and
    /// then renamed.
    fn take_room(&self, text: &str) -> io::Result<Open> {
        let kept = fs::read(&self.path).unwrap_or_default();
        let whole = kept.len() as u64 == SLOTS * SLOT as u64;
        let kept = String::from_utf8_lossy(&kept);
        let count = latest(&kept).filter(|_| whole).map(|(count, _)| count);
        if count.is_none() {
            let [none, first] = [slot(0, text)?, slot(1, text)?];
            replace_file(&self.path, &(none + &first))?;
        }
        Ok(Open {
            file: OpenOptions::new().write(true).open(&self.path)?,
            count: count.unwrap_or(1),
        })
    }
}

fn slot(count: u64, text: &str) -> io::Result<String> {
    let content = format!("{count} {text}");
    let line = format!("{} {content}", checksum(&content));
    if line.len() >= SLOT || text.contains('\n') {
        return Err(io::ErrorKind::FileTooLarge.into());
    }
    Ok(format!("{line:<0$}\n", SLOT - 1 - (line.len() - line.chars().count())))
}

fn checksum(content: &str) -> String {
    volcomp_model::hexadecimal(&Sha256::digest(content.as_bytes()))
}

/// The intact text with the largest counter, and its counter; `None` if no slot is intact.
pub(crate) fn latest(file: &str) -> Option<(u64, &str)> {
    let whole = file.lines().filter_map(|line| {
        let (sum, content) = line.trim_end().split_once(' ')?;
        let (count, text) = content.split_once(' ')?;
        (checksum(content) == sum).then_some((count.parse().ok()?, text))
    });
    whole.max_by_key(|(count, _)| *count)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::{SLOT, Slots, latest};

    fn read(path: &std::path::Path) -> Option<String> {
        let bytes = fs::read(path).expect("there");
        let text = String::from_utf8_lossy(&bytes);
        latest(&text).map(|(_, text)| text.to_owned())
    }

    #[test]
    fn the_last_text_is_read_after_a_restart() {
        let dir = tempfile::tempdir().expect("writable");
        let path = dir.path().join("standing.slots");
        for start in 0..3 {
            let mut slots = Slots::new(path.clone());
            for n in 0..5 {
                let text = format!("{{\"who\":\"Jürgen {start} {n}\"}}");
                slots.keep(&text).expect("writable");
                assert_eq!(read(&path).as_deref(), Some(text.as_str()));
                assert_eq!(fs::metadata(&path).expect("there").len(), 2 * SLOT as u64);
            }
        }
    }

    /// After a power failure during a write, either the new or the previous text is read, whichever part of the new slot
    /// reached the disk.
    #[test]
    fn a_torn_slot_leaves_the_text_before() {
        let dir = tempfile::tempdir().expect("writable");
        let path = dir.path().join("standing.slots");
        let mut slots = Slots::new(path.clone());
        for (before, after) in [("[1]", "[22]"), ("[22]", "[333]")] {
            slots.keep(before).expect("writable");
            let old = fs::read(&path).expect("there");
            slots.keep(after).expect("writable");
            let new = fs::read(&path).expect("there");
            let mut news = 0;
            for torn in (0..200).chain([SLOT, SLOT + 90, 2 * SLOT]) {
                for from_behind in [false, true] {
                    let mut mixed = old.clone();
                    let at = if from_behind { torn..new.len() } else { 0..torn };
                    mixed[at.clone()].copy_from_slice(&new[at]);
                    let other = dir.path().join("torn");
                    fs::write(&other, &mixed).expect("writable");
                    let found = read(&other);
                    assert!(
                        [Some(before), Some(after)].contains(&found.as_deref()),
                        "{torn}: {found:?}"
                    );
                    news += usize::from(found.as_deref() == Some(after));
                }
            }
            assert!(news > 0);
        }
    }

    #[test]
    fn a_file_that_is_removed_cut_or_foreign_is_made_anew() {
        let dir = tempfile::tempdir().expect("writable");
        let path = dir.path().join("standing.slots");
        let mut slots = Slots::new(path.clone());
        slots.keep("[1]").expect("writable");
        fs::remove_file(&path).expect("there");
        slots.keep("[2]").expect("writable");
        assert_eq!(read(&path).as_deref(), Some("[2]"));
        fs::write(&path, "{}").expect("writable");
        slots.keep("[3]").expect("writable");
        assert_eq!(read(&path).as_deref(), Some("[3]"));
        assert!(slots.keep(&"x".repeat(SLOT)).is_err());
        assert_eq!(read(&path).as_deref(), Some("[3]"));
    }
}
