//! Keys that sign manifests, each in a separate file readable only by its owner, and the seeds of nkeys.
//!
//! A key file holds one line: the 32 bytes of the secret key, base64. `volcomp-centre key list` prints the public key, which the machines must
//! trust.

use std::{
    fs,
    io::{self, Write},
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use crate::Error;
use base64::{Engine, engine::general_purpose::STANDARD as BASE64};
use volcomp_document::private;
use volcomp_fleet::SigningKey;

const END: &str = "key";

#[derive(Clone)]
pub struct Key {
    /// Name of the key file without the extension.
    pub name: String,
    pub key: SigningKey,
}

impl Key {
    /// The public key, base64, as in `trusted_keys` of a gateway.
    pub fn public(&self) -> String {
        BASE64.encode(self.key.verifying_key().to_bytes())
    }

    pub fn create(folder: &Path, name: &str) -> Result<Self, Error> {
        let mut secret = [0; 32];
        getrandom::fill(&mut secret).map_err(Error::Random)?;
        let file = path(folder, name)?;
        write_secret(&file, &BASE64.encode(secret))?;
        Ok(Self { name: name.to_owned(), key: SigningKey::from_bytes(&secret) })
    }

    pub fn read(folder: &Path, name: &str) -> Result<Self, Error> {
        let file = path(folder, name)?;
        let text = private::read(&file)?;
        let secret = BASE64.decode(text.trim()).ok();
        let secret: Option<[u8; 32]> = secret.and_then(|bytes| bytes.try_into().ok());
        let secret = secret.ok_or_else(|| content(&file, "base64 of 32 bytes"))?;
        Ok(Self { name: name.to_owned(), key: SigningKey::from_bytes(&secret) })
    }

    /// Every key of a folder, sorted by name; empty if the folder does not exist.
    pub fn all(folder: &Path) -> Result<Vec<Self>, Error> {
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

fn path(folder: &Path, name: &str) -> Result<PathBuf, Error> {
    let fits =
        !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_');
    if fits {
        Ok(folder.join(format!("{name}.{END}")))
    } else {
        Err(Error::Wrong(format!(
            "found the name {name:?}, expected letters, digits, hyphens and underscores"
        )))
    }
}

pub(crate) fn failed(file: &Path) -> impl FnOnce(io::Error) -> Error {
    let file = file.display().to_string();
    move |source| Error::File { file, source }
}

pub(crate) fn content(file: &Path, expected: &str) -> Error {
    Error::Wrong(format!("{}: expected {expected}", file.display()))
}

/// Writes a secret and a line end to a new file with mode 0600. Fails if the file exists.
pub fn write_secret(file: &Path, text: &str) -> Result<(), Error> {
    let write = || -> io::Result<()> {
        let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new("."));
        fs::create_dir_all(folder)?;
        // Write a temporary file first, so that a full disk leaves no partial secret.
        let mut opened = tempfile::Builder::new()
            .permissions(fs::Permissions::from_mode(0o600))
            .tempfile_in(folder)?;
        writeln!(opened, "{text}")?;
        opened.as_file().sync_all()?;
        opened.persist_noclobber(file).map_err(|failed| failed.error)?;
        Ok(())
    };
    write().map_err(|error| match error.kind() {
        io::ErrorKind::AlreadyExists => {
            Error::Wrong(format!("{}: exists and is not replaced", file.display()))
        }
        _ => failed(file)(error),
    })
}
