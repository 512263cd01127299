//! Writes files atomically: into a temporary file that is renamed when it is complete.

use std::{
    io::{self, BufWriter, Write},
    path::Path,
};

use tempfile::NamedTempFile;

use crate::failure::Failure;

/// Writes a file. If `write` fails, an existing file stays unchanged, and a new file is not created.
pub(crate) fn write_file<R>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<NamedTempFile>) -> Result<R, Failure>,
) -> Result<R, Failure> {
    let failed = |error: io::Error| Failure::system(path, error);
    // A device or a pipe must not be replaced.
    if path.exists() && !path.is_file() {
        let what = "cannot be written: found a folder or a device, expected a file";
        return Err(Failure::in_file(path, what));
    }
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        // Permissions of a new file under the umask; temporary files are private by default.
        builder.permissions(std::fs::Permissions::from_mode(0o666));
    }
    let mut file = BufWriter::new(builder.tempfile_in(folder).map_err(failed)?);
    let result = write(&mut file)?;
    file.flush().map_err(failed)?;
    let file = file.into_inner().map_err(|error| failed(error.into_error()))?;
    file.as_file().sync_all().map_err(failed)?;
    file.persist(path).map_err(|error| failed(error.error))?;
    Ok(result)
}
