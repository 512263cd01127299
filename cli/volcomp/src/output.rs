//! Standard output, and files that appear whole or not at all.

use std::{
    io::{self, BufWriter, ErrorKind, Write},
    path::{Path, PathBuf},
};

use tempfile::NamedTempFile;

use crate::failure::Failure;

/// Writes to standard output; a reader that has gone away is no failure.
pub(crate) fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Work(format!("standard output: {e}")))
        }
        _ => Ok(()),
    }
}

/// A file that appears by rename when everything is written.
pub(crate) struct OutputFile {
    path: PathBuf,
    writer: BufWriter<NamedTempFile>,
}

impl OutputFile {
    /// Opens the output before work starts.
    pub(crate) fn open(path: &Path) -> Result<Self, Failure> {
        let refused = |why: &dyn std::fmt::Display| {
            Failure::Input(format!("{}: cannot be written: {why}", path.display()))
        };
        if path.is_dir() {
            return Err(refused(&"it is a directory, expected a file"));
        }
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        // A device or pipe cannot be renamed over.
        if path.exists() && !path.is_file() {
            return Err(refused(&"it is no ordinary file"));
        }
        let file = tempfile::Builder::new()
            .permissions_as_new_file()
            .tempfile_in(folder)
            .map_err(|e| refused(&e))?;
        Ok(Self {
            path: path.to_owned(),
            writer: BufWriter::new(file),
        })
    }

    pub(crate) fn write(&mut self, text: &str) -> Result<(), Failure> {
        self.writer
            .write_all(text.as_bytes())
            .map_err(|e| Failure::work_on(&self.path, &e))
    }

    /// Everything is written: the file takes its name.
    pub(crate) fn finish(self) -> Result<(), Failure> {
        let path = self.path;
        let file = self
            .writer
            .into_inner()
            .map_err(|e| Failure::work_on(&path, &e.into_error()))?;
        file.as_file()
            .sync_all()
            .map_err(|e| Failure::work_on(&path, &e))?;
        file.persist(&path)
            .map_err(|e| Failure::work_on(&path, &e.error))?;
        Ok(())
    }
}

trait PermissionsAsNewFile {
    fn permissions_as_new_file(&mut self) -> &mut Self;
}

impl PermissionsAsNewFile for tempfile::Builder<'_, '_> {
    /// Temporary files are private by default; a result is an ordinary file under the umask.
    fn permissions_as_new_file(&mut self) -> &mut Self {
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            self.permissions(std::fs::Permissions::from_mode(0o666));
        }
        self
    }
}
