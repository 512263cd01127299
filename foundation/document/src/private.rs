//! Files that hold a secret: keys, seeds, passwords, tokens. Only their owner may read them.

use std::{
    fs::File,
    io::{self, Read},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

/// Why a secret is not taken from a file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PrivateError {
    /// The file cannot be read.
    #[error("{}: {source}", file.display())]
    Read {
        /// The path of the file.
        file: PathBuf,
        /// Why the operating system refused it.
        source: io::Error,
    },
    /// Others may read it.
    #[error(
        "{}: found mode {mode:03o}, expected 600: a secret that others can read is none", file.display()
    )]
    Mode {
        /// The path of the file.
        file: PathBuf,
        /// Its mode.
        mode: u32,
    },
}

/// Reads a file that nobody but its owner may read, or that the service manager has put among the credentials of this service.
///
/// # Errors
/// It cannot be read, is no text, or others may read it.
pub fn read(path: &Path) -> Result<String, PrivateError> {
    let failed = |source| PrivateError::Read {
        file: path.to_owned(),
        source,
    };
    let mut file = File::open(path).map_err(failed)?;
    let mode = file.metadata().map_err(failed)?.permissions().mode() & 0o777;
    // The service manager keeps the folder of its credentials private; their modes may show an access list.
    let is_credential =
        std::env::var_os("CREDENTIALS_DIRECTORY").is_some_and(|folder| path.starts_with(folder));
    if mode & 0o077 != 0 && !is_credential {
        return Err(PrivateError::Mode {
            file: path.to_owned(),
            mode,
        });
    }
    let mut text = String::new();
    file.read_to_string(&mut text).map_err(failed)?;
    Ok(text)
}
