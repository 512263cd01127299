//! Whether the audit log can be written into its folder, as far as that is known without writing anything.

use std::{io, path::Path};

use rustix::fs::{Access, FsWord, PROC_SUPER_MAGIC, access, statfs};

use crate::{audit, error::GatewayError};

/// The type of the file system of `/sys`, as `statfs` answers it.
const SYSFS_MAGIC: FsWord = 0x6265_6572;

/// Refuses a folder that cannot be made or written by the user of this program: one that lies below a file, or is one;
/// one whose name no file system takes; one in a folder that may not be written.
pub(super) fn check(dir: &Path) -> Result<(), GatewayError> {
    let wrong = |found: &Path| {
        Err(GatewayError::AuditDir {
            dir: dir.to_owned(),
            found: found.to_owned(),
        })
    };
    let refused = |found: &Path, source: io::Error| GatewayError::AuditAccess {
        dir: dir.to_owned(),
        found: found.to_owned(),
        source,
    };
    for above in dir.ancestors() {
        // What is above a relative path is the folder in which the program was started.
        let above = if above == Path::new("") {
            Path::new(".")
        } else {
            above
        };
        // A link that leads nowhere is there, and is no folder.
        match (above.symlink_metadata(), above.metadata()) {
            (_, Ok(found)) if found.is_dir() => {
                can_write_in(above).map_err(|source| refused(above, source))?;
                break;
            }
            (Ok(_), _) => return wrong(above),
            (Err(source), _) if is_missing(&source) => {}
            (Err(source), _) => return Err(refused(above, source)),
        }
    }
    let log = audit::log_file(dir);
    if log.is_dir() {
        return wrong(&log);
    }
    match access(&log, Access::READ_OK | Access::WRITE_OK).map_err(io::Error::from) {
        Err(source) if !is_missing(&source) => Err(refused(&log, source)),
        _ => Ok(()),
    }
}

/// Whether nothing is there: missing, or below something that is no folder.
fn is_missing(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::NotFound | io::ErrorKind::NotADirectory
    )
}

/// Whether files and folders may be made in a folder. The kernel's own file systems take none, not even from the
/// superuser, whom `access` lets write everywhere.
fn can_write_in(folder: &Path) -> io::Result<()> {
    access(folder, Access::WRITE_OK | Access::EXEC_OK)?;
    if [PROC_SUPER_MAGIC, SYSFS_MAGIC].contains(&statfs(folder)?.f_type) {
        return Err(io::ErrorKind::PermissionDenied.into());
    }
    Ok(())
}
