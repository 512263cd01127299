//! A measurement file of any kind, by its extension.

use std::io::Read;
use std::path::Path;

use crate::{Measurement, MetrologyError, RenishawKind, parse_csv, parse_renishaw};

/// The extensions that [`read_file`] knows, for messages.
pub const READ_EXTENSIONS: &str = ".rtl, .rta, .csv";

const LIMIT_MIB: u64 = 256;

/// Reads a measurement file: `.rtl` and `.rta` (Renishaw laser), `.csv` (table of readings), case ignored.
///
/// The extension says how to read, the content is checked against it.
///
/// # Errors
/// The file cannot be read, its extension is not known, or its content is broken: see [`parse_csv`] and
/// [`parse_renishaw`].
pub fn read_file(path: &Path) -> Result<Measurement, MetrologyError> {
    let name = path.display().to_string();
    let extension = path
        .extension()
        .map(|e| e.to_string_lossy().to_lowercase())
        .unwrap_or_default();
    if path.is_dir() {
        return Err(MetrologyError::Directory { file: name });
    }
    match extension.as_str() {
        "rtl" => parse_renishaw(&bytes_of(path, &name)?, &name, RenishawKind::Linear),
        "rta" => parse_renishaw(&bytes_of(path, &name)?, &name, RenishawKind::Angular),
        "csv" => parse_csv(&bytes_of(path, &name)?, &name),
        _ => Err(MetrologyError::Extension {
            file: name,
            found: extension_found(&extension),
        }),
    }
}

fn bytes_of(path: &Path, name: &str) -> Result<Vec<u8>, MetrologyError> {
    let unreadable = |source| MetrologyError::Unreadable {
        file: name.into(),
        source,
    };
    let limit = LIMIT_MIB * 1024 * 1024;
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(unreadable)?;
    file.take(limit + 1)
        .read_to_end(&mut bytes)
        .map_err(unreadable)?;
    if bytes.len() as u64 > limit {
        return Err(MetrologyError::TooLarge {
            file: name.into(),
            limit_mib: LIMIT_MIB,
        });
    }
    Ok(bytes)
}

fn extension_found(extension: &str) -> String {
    if extension.is_empty() {
        "no extension".into()
    } else {
        format!("the extension `{extension}`")
    }
}
