//! The keys by which manifests are signed, each in a file of its own that nobody else may read, and the seeds of nkeys.
//!
//! A key file holds one line: the 32 bytes of the secret key, base64. Its public key, which the machines trust, is told by
//! `volcomp-centre key list`.

use std::{
    fs,
    io::{self, Write},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use base64::{Engine, engine::general_purpose::STANDARD as BASE64};
use volcomp_document::{PrivateError, private};
use volcomp_fleet::SigningKey;

/// The end of the names of key files.
const END: &str = "key";

/// Why there is no key.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum KeyError {
    /// The file is there: a secret is never written over.
    #[error("{}: there already, kept", file.display())]
    There { file: PathBuf },
    /// A file cannot be read or written.
    #[error("{}: {source}", .file.display())]
    File {
        file: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// A secret cannot be read, or others may read it.
    #[error(transparent)]
    Private(#[from] PrivateError),
    /// It holds something else.
    #[error("{}: expected {expected}", .file.display())]
    Content {
        file: PathBuf,
        /// What it should hold.
        expected: &'static str,
    },
    /// The operating system gives no random numbers.
    #[error("random numbers: {0}")]
    Random(getrandom::Error),
    /// A name that makes no name of a file.
    #[error("found the name {found:?}, expected letters, digits, hyphens and underscores")]
    Name {
        /// The name.
        found: String,
    },
}

/// A key with its name.
#[derive(Clone)]
pub struct Key {
    /// The name of its file without the end.
    pub name: String,
    pub key: SigningKey,
}

impl Key {
    /// The public key, base64, as `trusted_keys` of a gateway has it.
    pub fn public(&self) -> String {
        BASE64.encode(self.key.verifying_key().to_bytes())
    }

    /// Draws a new key, and writes it into a new file of the folder.
    ///
    /// # Errors
    /// There is a file of this name, or it cannot be written.
    pub fn create(folder: &Path, name: &str) -> Result<Self, KeyError> {
        let mut secret = [0; 32];
        getrandom::fill(&mut secret).map_err(KeyError::Random)?;
        let file = path(folder, name)?;
        write_secret(&file, &BASE64.encode(secret))?;
        Ok(Self {
            name: name.to_owned(),
            key: SigningKey::from_bytes(&secret),
        })
    }

    /// Reads the key of this name.
    ///
    /// # Errors
    /// There is none, it holds something else, or others may read it.
    pub fn read(folder: &Path, name: &str) -> Result<Self, KeyError> {
        let file = path(folder, name)?;
        let text = private::read(&file)?;
        let secret = BASE64.decode(text.trim()).ok();
        let secret: Option<[u8; 32]> = secret.and_then(|bytes| bytes.try_into().ok());
        let secret = secret.ok_or(KeyError::Content {
            file,
            expected: "base64 of 32 bytes",
        })?;
        Ok(Self {
            name: name.to_owned(),
            key: SigningKey::from_bytes(&secret),
        })
    }

    /// Every key of a folder, by name; none where there is no folder.
    ///
    /// # Errors
    /// One of them cannot be read.
    pub fn all(folder: &Path) -> Result<Vec<Self>, KeyError> {
        let entries = match fs::read_dir(folder) {
            Ok(entries) => entries,
            Err(e) if e.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(e) => return Err(failed(folder)(e)),
        };
        let mut names = Vec::new();
        for entry in entries {
            let file = entry.map_err(failed(folder))?.path();
            let is_key = file.extension().is_some_and(|end| end == END);
            if let Some(name) = file.file_stem().and_then(|name| name.to_str())
                && is_key
            {
                names.push(name.to_owned());
            }
        }
        names.sort();
        names.iter().map(|name| Self::read(folder, name)).collect()
    }
}

fn path(folder: &Path, name: &str) -> Result<PathBuf, KeyError> {
    let fits = !name.is_empty()
        && name
            .chars()
            .all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_');
    if fits {
        Ok(folder.join(format!("{name}.{END}")))
    } else {
        Err(KeyError::Name {
            found: name.to_owned(),
        })
    }
}

fn failed(file: &Path) -> impl FnOnce(io::Error) -> KeyError {
    let file = file.to_owned();
    move |source| KeyError::File { file, source }
}

/// Writes a secret and a line end into a new file, mode 0600.
///
/// # Errors
/// There is such a file, or it cannot be written.
pub fn write_secret(file: &Path, text: &str) -> Result<(), KeyError> {
    let write = || -> io::Result<()> {
        let folder = file
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        fs::create_dir_all(folder)?;
        // Beside it first, so that a full disk leaves no half of a secret.
        let mut opened = tempfile::Builder::new()
            .permissions(fs::Permissions::from_mode(0o600))
            .tempfile_in(folder)?;
        writeln!(opened, "{text}")?;
        opened.as_file().sync_all()?;
        opened
            .persist_noclobber(file)
            .map_err(|failed| failed.error)?;
        Ok(())
    };
    write().map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => KeyError::There {
            file: file.to_owned(),
        },
        _ => failed(file)(error),
    })
}
