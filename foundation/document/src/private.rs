//! Files that contain a secret: keys, seeds, passwords, tokens. Only their owner may read them. This is checked on Unix
//! only.

use std::{
    fs::{File, Metadata},
    io,
    path::{Path, PathBuf},
};

use crate::read;

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PrivateError {
    #[error("{}: {source}", file.display())]
    Read {
        file: PathBuf,
        /// Error of the operating system when opening or reading the file.
        source: io::Error,
    },
    #[error(
        "{}: found mode {mode:03o}, expected 600: others may read this secret", file.display()
    )]
    Mode {
        file: PathBuf,
        /// Permission bits of the file, which give other users access.
        mode: u32,
    },
}

/// Whether a mode gives users other than the owner any access to a file.
#[must_use]
pub fn is_open_to_others(mode: u32) -> bool {
    mode & 0o077 != 0
}

/// Opens a file that only its owner may read, or that the service manager provides in the credentials folder of this
/// service.
///
/// # Errors
/// The file cannot be opened, is a named pipe, or other users may read it.
pub fn open(path: &Path) -> Result<File, PrivateError> {
    let failed = |source| PrivateError::Read { file: path.to_owned(), source };
    let file = read::open(path).map_err(failed)?;
    let mode = mode(&file.metadata().map_err(failed)?);
    // The service manager keeps its credentials folder private, and the modes of the files in it may only reflect an
    // access list.
    let is_credential =
        std::env::var_os("CREDENTIALS_DIRECTORY").is_some_and(|folder| path.starts_with(folder));
    if is_open_to_others(mode) && !is_credential {
        return Err(PrivateError::Mode { file: path.to_owned(), mode });
    }
    Ok(file)
}

#[cfg(unix)]
fn mode(metadata: &Metadata) -> u32 {
    use std::os::unix::fs::PermissionsExt;
    metadata.permissions().mode() & 0o777
}

/// Windows has no modes. The access list of the folder protects the file instead.
#[cfg(not(unix))]
fn mode(_: &Metadata) -> u32 {
    0o600
}

/// Reads the text of a file that only its owner may read; for exceptions see [`open`].
///
/// # Errors
/// The file cannot be read, is not text, is longer than [`MAX_TEXT_BYTES`](crate::MAX_TEXT_BYTES), or other users may read it.
pub fn read(path: &Path) -> Result<String, PrivateError> {
    let file = open(path)?;
    let text = read::bytes_of(file).and_then(|bytes| {
        let wrong = |error| io::Error::new(io::ErrorKind::InvalidData, error);
        String::from_utf8(bytes).map_err(wrong)
    });
    text.map_err(|source| PrivateError::Read { file: path.to_owned(), source })
}

#[cfg(all(test, unix))]
mod tests {
    use std::{fs, os::unix::fs::PermissionsExt};

    use super::*;

    #[test]
    fn a_secret_that_others_can_read_is_none() {
        let dir = tempfile::tempdir().expect("writable");
        let file = dir.path().join("seed");
        fs::write(&file, "secret").expect("writable");
        for (mode, is_taken) in
            [(0o600, true), (0o400, true), (0o640, false), (0o604, false), (0o620, false)]
        {
            fs::set_permissions(&file, fs::Permissions::from_mode(mode)).expect("ours");
            match read(&file) {
                Ok(text) => assert!(is_taken && text == "secret", "{mode:o}"),
                Err(PrivateError::Mode { mode: found, .. }) => {
                    assert!(!is_taken && found == mode, "{mode:o}");
                }
                Err(other) => panic!("{other}"),
            }
        }
    }

    #[test]
    fn a_secret_of_a_terabyte_is_not_read_to_its_end() {
        let dir = tempfile::tempdir().expect("writable");
        let path = dir.path().join("seed");
        let file = File::create(&path).expect("writable");
        file.set_len(1 << 40).expect("a sparse file");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o600)).expect("ours");
        let error = read(&path).expect_err("too long").to_string();
        assert!(error.ends_with("seed: found more than 256 MiB, expected at most that"), "{error}");
    }
}
