//! Standard output, and files that are written atomically.

use std::{
    collections::BTreeSet,
    io::{self, BufWriter, ErrorKind, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
};

use tempfile::{NamedTempFile, TempDir};

use crate::failure::Failure;

/// Writes a text to standard output.
pub(crate) fn print(text: &str) -> Result<(), Failure> {
    print_by(|out| out.write_all(text.as_bytes()))
}

/// Writes text to standard output. Headers are bold only on a terminal, unless `NO_COLOR` is set.
pub(crate) fn print_by(
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Failure> {
    let out = anstream::AutoStream::auto(io::stdout().lock());
    written(BufWriter::new(out), write)
}

/// Writes text without styles to standard output.
pub(crate) fn print_plain(
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Failure> {
    written(io::stdout().lock(), write)
}

/// Writes to standard output; a broken pipe is ignored.
fn written(
    mut out: impl Write,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Failure> {
    match write(&mut out).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Work(format!("standard output: {e}")))
        }
        _ => Ok(()),
    }
}

/// Unfinished files and temporary folders, which are removed if the program is interrupted.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// On Ctrl-C or termination, removes unfinished files and exits with status 130, as a shell does.
pub(crate) fn clean_up_when_interrupted() {
    let clean_up = || {
        for path in unfinished().iter() {
            // The file may already have been removed. Errors cannot be reported here.
            let _ = if path.is_dir() {
                std::fs::remove_dir_all(path)
            } else {
                std::fs::remove_file(path)
            };
        }
        eprintln!("interrupted: nothing half-written is left");
        std::process::exit(130);
    };
    if let Err(e) = ctrlc::set_handler(clean_up) {
        tracing::warn!("Ctrl-C may leave unfinished files: {e}");
    }
}

pub(crate) struct TemporaryFolder(TempDir);

impl TemporaryFolder {
    pub(crate) fn new() -> Result<Self, Failure> {
        let folder =
            tempfile::tempdir().map_err(|e| Failure::Work(format!("temporary folder: {e}")))?;
        unfinished().insert(folder.path().to_owned());
        Ok(Self(folder))
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        unfinished().remove(self.0.path());
    }
}

/// A file that becomes visible by rename once its content is complete.
pub(crate) struct OutputFile {
    path: PathBuf,
    temporary: PathBuf,
    writer: Option<BufWriter<NamedTempFile>>,
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        unfinished().remove(&self.temporary);
    }
}

impl OutputFile {
    /// Opens an output before the work starts, so that an unwritable path fails early.
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
        // A rename must not replace a device or a pipe.
        if path.exists() && !path.is_file() {
            return Err(refused(&"it is no ordinary file"));
        }
        if !folder.is_dir() {
            return Err(refused(&format_args!("there is no folder {}", folder.display())));
        }
        let file = tempfile::Builder::new().permissions_as_new_file().tempfile_in(folder).map_err(
            |e| {
                // Remove the name of the temporary file, which would not help the user.
                let message = e.to_string();
                refused(&message.split(" at path ").next().unwrap_or_default())
            },
        )?;
        let temporary = file.path().to_owned();
        unfinished().insert(temporary.clone());
        Ok(Self { path: path.to_owned(), temporary, writer: Some(BufWriter::new(file)) })
    }

    /// Opens an output that must not be one of the `inputs`. Each input comes with its option, which the message names.
    pub(crate) fn open_beside(path: &Path, inputs: &[(&Path, &str)]) -> Result<Self, Failure> {
        for (input, option) in inputs {
            if let (Ok(output), Ok(input)) = (path.canonicalize(), input.canonicalize())
                && output == input
            {
                return Err(Failure::in_file(
                    path,
                    format_args!("this is the file of {option}, expected another one to write"),
                ));
            }
        }
        Self::open(path)
    }

    /// True if a file with another text exists, which the output will replace.
    pub(crate) fn replaces(&self, text: &str) -> bool {
        std::fs::read(&self.path).is_ok_and(|there| there != text.as_bytes())
    }

    pub(crate) fn append(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        match &mut self.writer {
            Some(writer) => writer.write_all(bytes).map_err(|e| Failure::work_on(&self.path, &e)),
            None => Ok(()),
        }
    }

    pub(crate) fn write_whole(mut self, bytes: impl AsRef<[u8]>) -> Result<(), Failure> {
        self.append(bytes.as_ref())?;
        self.finish()
    }

    pub(crate) fn so_far(&mut self) -> Result<&Path, Failure> {
        self.flush().map_err(|e| Failure::work_on(&self.path, &e))?;
        Ok(&self.temporary)
    }

    pub(crate) fn finish(mut self) -> Result<(), Failure> {
        let Some(writer) = self.writer.take() else {
            return Ok(());
        };
        let failed = |e: &io::Error| Failure::work_on(&self.path, e);
        let file = writer.into_inner().map_err(|e| failed(e.error()))?;
        file.as_file().sync_all().map_err(|e| failed(&e))?;
        file.persist(&self.path).map_err(|e| failed(&e.error))?;
        tracing::debug!("wrote {}", self.path.display());
        Ok(())
    }
}

/// Libraries write to the file through `io::Write`.
impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.as_mut().map_or(Ok(0), |writer| writer.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.as_mut().map_or(Ok(()), Write::flush)
    }
}

trait PermissionsAsNewFile {
    fn permissions_as_new_file(&mut self) -> &mut Self;
}

impl PermissionsAsNewFile for tempfile::Builder<'_, '_> {
    /// Sets the permissions of a new file under the umask, because temporary files are private by default.
    fn permissions_as_new_file(&mut self) -> &mut Self {
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            self.permissions(std::fs::Permissions::from_mode(0o666));
        }
        self
    }
}
