//! Files that come over HTTP: their names, their room, and how they get onto the disk. A thread of its own writes each of
//! them, so that a disk that hangs holds up no other request.

use std::{
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
};

use rustix::fs::statvfs;

/// The largest number of files of one upload.
pub(crate) const MOST_FILES: usize = 200;
/// The largest file, bytes. Making a model takes some thirty times as much in memory of the program that corrects.
pub(crate) const LARGEST_FILE: u64 = 4 * 1024 * 1024;
/// All files of an upload together are at most so many times the largest one.
pub(crate) const TIMES: u64 = 4;
/// So much of the disk stays free: the audit log, without which nobody arms, needs room.
const RESERVE: u64 = 64 * 1024 * 1024;
/// The longest name, bytes.
const LONGEST: usize = 120;

/// Why a file is not taken.
#[derive(Debug, thiserror::Error)]
pub(crate) enum UploadError {
    #[error("the name {name:?} has nothing in it that could be a file name")]
    Name { name: String },
    #[error("{name:?}: a measurement file was expected, TOML files say something of others")]
    Toml { name: String },
    #[error("a file of the name {name} has been uploaded already")]
    Twice { name: String },
    #[error("{MOST_FILES} files have been uploaded already, which is the most")]
    Files,
    #[error(
        "the file is larger than {mib} MiB, the most that is taken: make the model with `volcomp calibrate` and upload the machine file"
    )]
    Large { mib: u64 },
    #[error(
        "all files together are larger than {mib} MiB, the most that is taken: make the model with `volcomp calibrate` and upload the machine file"
    )]
    Quota { mib: u64 },
    #[error("the disk is full: less than {} MiB would be left free, which the audit log needs", RESERVE / 1024 / 1024)]
    Full,
    #[error("the file ended in the middle: {bytes} bytes came, and nothing of it was kept")]
    Cut { bytes: u64 },
    #[error("the file cannot be written: {0}")]
    Disk(#[from] std::io::Error),
}

impl UploadError {
    /// The status of HTTP.
    pub(crate) fn status(&self) -> u16 {
        match self {
            Self::Name { .. } | Self::Toml { .. } | Self::Cut { .. } => 400,
            Self::Twice { .. } | Self::Files => 409,
            Self::Large { .. } | Self::Quota { .. } => 413,
            Self::Full | Self::Disk(_) => 507,
        }
    }
}

/// The name of a file in the folder of uploads: the last part of what the browser calls it, and of that letters, digits and a
/// few signs; nothing hidden, nothing that leads elsewhere.
pub(crate) fn sanitised(name: &str) -> Result<String, UploadError> {
    let wrong = || UploadError::Name {
        name: name.chars().take(LONGEST).collect(),
    };
    let last = name.rsplit(['/', '\\']).next().unwrap_or_default();
    let is_plain = |c: char| c.is_alphanumeric() || matches!(c, '-' | '_' | '.' | '+' | ' ');
    let plain: String = last
        .chars()
        .map(|c| if is_plain(c) { c } else { '_' })
        .collect();
    let mut plain = plain.trim_matches(['.', ' ']).to_owned();
    if plain.len() > LONGEST {
        // The ending says what it is.
        let (stem, ending) = plain.rsplit_once('.').unwrap_or((&plain, ""));
        let ending: String = ending.chars().take(10).collect();
        let mut short = String::new();
        for c in stem.chars() {
            if short.len() + c.len_utf8() + ending.len() + 1 > LONGEST {
                break;
            }
            short.push(c);
        }
        plain = format!("{short}.{ending}");
    }
    if plain.chars().any(char::is_alphanumeric) {
        Ok(plain)
    } else {
        Err(wrong())
    }
}

/// Whether the disk has room for so many bytes more.
pub(crate) fn check_room(folder: &Path, bytes: u64) -> Result<(), UploadError> {
    // A disk that does not tell is tried.
    let Ok(disk) = statvfs(folder) else {
        return Ok(());
    };
    let free = disk.f_bavail.saturating_mul(disk.f_frsize);
    if free < bytes.saturating_add(RESERVE) {
        Err(UploadError::Full)
    } else {
        Ok(())
    }
}

/// A file on its way onto the disk, under a hidden name until it is whole. What is dropped before is removed.
pub(crate) struct Incoming {
    file: File,
    part: PathBuf,
    whole: PathBuf,
    bytes: u64,
    most: u64,
    is_done: bool,
}

impl Incoming {
    /// Begins a file of at most so many bytes.
    pub(crate) fn begin(folder: &Path, name: &str, most: u64) -> Result<Self, UploadError> {
        check_room(folder, 0)?;
        let whole = folder.join(name);
        let part = folder.join(format!(".{name}.part"));
        // What was cut before is written over.
        let file = File::create(&part)?;
        Ok(Self {
            file,
            part,
            whole,
            bytes: 0,
            most,
            is_done: false,
        })
    }

    /// Goes on with it.
    pub(crate) fn write(&mut self, bytes: &[u8]) -> Result<(), UploadError> {
        self.bytes += bytes.len() as u64;
        if self.bytes > self.most {
            return Err(UploadError::Large {
                mib: self.most / 1024 / 1024,
            });
        }
        if let Some(folder) = self.part.parent() {
            check_room(folder, bytes.len() as u64)?;
        }
        Ok(self.file.write_all(bytes)?)
    }

    /// The file is whole: its size.
    pub(crate) fn done(mut self) -> Result<u64, UploadError> {
        self.file.sync_all()?;
        fs::rename(&self.part, &self.whole)?;
        self.is_done = true;
        Ok(self.bytes)
    }

    /// How many bytes came.
    pub(crate) fn bytes(&self) -> u64 {
        self.bytes
    }
}

impl Drop for Incoming {
    fn drop(&mut self) {
        if !self.is_done {
            // The next upload would write over it.
            let _ = fs::remove_file(&self.part);
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn names_lead_nowhere_else() {
        for (given, found) in [
            ("exx.rtl", "exx.rtl"),
            ("../x", "x"),
            ("..\\..\\x.csv", "x.csv"),
            ("/etc/passwd", "passwd"),
            ("<script>.rtl", "_script_.rtl"),
            (".hidden", "hidden"),
            ("Gerät 1 (X).rtl", "Gerät 1 _X_.rtl"),
            ("a\0b\n.csv", "a_b_.csv"),
        ] {
            assert_eq!(sanitised(given).expect(given), found);
        }
        for none in ["", ".", "..", "../", "<>", "/"] {
            assert!(sanitised(none).is_err(), "{none}");
        }
    }

    proptest! {
        /// Whatever a browser says: a name in this folder, not hidden, which no file system refuses.
        #[test]
        fn a_name_is_one_part_of_a_path(given in "\\PC{0,300}|.{0,300}") {
            if let Ok(name) = sanitised(&given) {
                prop_assert!(!name.starts_with('.') && name.len() <= LONGEST, "{name}");
                let path = Path::new("/folder").join(&name);
                prop_assert_eq!(path.parent(), Some(Path::new("/folder")));
                prop_assert_eq!(path.components().count(), 3);
                prop_assert!(!name.contains(['<', '>', '"', '\'', '&', '/', '\\', '\0']));
            }
        }
    }

    #[test]
    fn a_file_that_is_cut_or_too_large_leaves_nothing() {
        let dir = tempfile::tempdir().expect("writable");
        let count = || fs::read_dir(dir.path()).expect("there").count();
        let mut cut = Incoming::begin(dir.path(), "a.csv", 10).expect("writable");
        cut.write(b"12345").expect("it fits");
        drop(cut);
        assert_eq!(count(), 0);
        let mut large = Incoming::begin(dir.path(), "a.csv", 10).expect("writable");
        assert!(matches!(
            large.write(b"12345678901"),
            Err(UploadError::Large { .. })
        ));
        drop(large);
        assert_eq!(count(), 0);
        let mut whole = Incoming::begin(dir.path(), "a.csv", 10).expect("writable");
        whole.write(b"1234567890").expect("it fits");
        assert_eq!(whole.done().expect("writable"), 10);
        assert_eq!(
            fs::read(dir.path().join("a.csv")).expect("there"),
            b"1234567890"
        );
    }
}
