//! Reads a measurement file of any kind, which is selected by extension and content.

use std::io::Read;
use std::path::Path;

use crate::channel_log::{ChannelLog, is_log, parse_camonitor, readings_at_dwells};
use crate::circular::looks_like_circle;
use crate::laser_report::{is_report, parse_keysight_report, parse_pos};
use crate::mapped_table::{Mapping, parse_table_with};
use crate::renishaw::{Capture, parse_ren, parse_rtx};
use crate::text::{Place, decode, first_line};
use crate::{Measurement, MetrologyError, RenishawKind, parse_csv, parse_renishaw};
use volcomp_document::quoted;

/// File name extensions that [`read_file`] supports, for messages.
pub const READ_EXTENSIONS: &str = ".rtl, .rta, .rts, .rtx, .REN, .pos, .csv, .txt, .log, .dat";

const LIMIT_MIB: u64 = 256;

/// Content of a measurement file.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    Measurement(Box<Measurement>),
    /// Dynamic capture, without targets.
    Capture(Box<Capture>),
    /// Log of channels whose roles are unknown, because there is no mapping.
    Log(Box<ChannelLog>),
}

impl Content {
    /// # Errors
    ///
    /// A capture, or a log without a mapping, because it has no readings at targets.
    pub fn into_measurement(self) -> Result<Measurement, MetrologyError> {
        match self {
            Self::Measurement(measurement) => Ok(*measurement),
            Self::Capture(capture) => Err(MetrologyError::NoTargets {
                file: capture.name,
                found: format!("a dynamic capture of {} samples", capture.samples.len()),
                how: "measure with targets, `volcomp inspect` shows what the capture holds".into(),
            }),
            Self::Log(log) => {
                let names: Vec<&str> = log.channels.iter().map(|c| c.name.as_str()).collect();
                Err(MetrologyError::NoTargets {
                    found: format!("a log of the channels {}", names.join(", ")),
                    how: format!(
                        "state in `channels`, in the calibration file or in {} beside it, which channel is the target and which the reading",
                        file_name(&Mapping::beside(Path::new(&log.name)))
                    ),
                    file: log.name,
                })
            }
        }
    }
}

/// Reads a measurement file with readings at targets. The extension may be in upper or lower case.
///
/// The extension selects the reader, and the content is checked against it: `.rtl`, `.rta` and `.rts` (Renishaw laser),
/// `.REN` (compensation export), `.pos` (API laser), `.csv` (table of readings). For `.txt`, `.log` and `.dat` the
/// content selects the reader: reports of 5529 and 5530 lasers, or logs of `camonitor`. For a file NAME, the file
/// `NAME.toml` in the same folder states the roles of columns or channels ([`Mapping`]).
///
/// # Errors
/// The file cannot be read, its extension is unknown, its content is invalid, or it has no targets.
pub fn read_file(path: &Path) -> Result<Measurement, MetrologyError> {
    read_file_with(path, None)
}

/// Like [`read_file`], with the mapping of columns or channels from the caller. `None` uses the file `NAME.toml`, if
/// there is one.
///
/// # Errors
/// The errors of [`read_file`], and a mapping that does not fit the kind of file.
pub fn read_file_with(
    path: &Path,
    mapping: Option<&Mapping>,
) -> Result<Measurement, MetrologyError> {
    read_content(path, mapping)?.into_measurement()
}

/// Reads a file of any kind, including kinds without targets.
///
/// # Errors
/// The errors of [`read_file`].
pub fn read_content(path: &Path, mapping: Option<&Mapping>) -> Result<Content, MetrologyError> {
    let name = path.display().to_string();
    let extension =
        path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    if path.is_dir() {
        return Err(MetrologyError::Directory { file: name });
    }
    let bytes = || bytes_of(path, &name);
    let renishaw = |kind| parse_renishaw(&bytes()?, &name, kind);
    let measurement = match extension.as_str() {
        "rtl" => renishaw(RenishawKind::Linear)?,
        "rta" => renishaw(RenishawKind::Angular)?,
        "rts" => renishaw(RenishawKind::Straightness)?,
        "ren" => parse_ren(&bytes()?, &name)?,
        "pos" => parse_pos(&bytes()?, &name)?,
        "rtx" => return Ok(Content::Capture(Box::new(parse_rtx(&bytes()?, &name)?))),
        "csv" | "txt" | "log" | "dat" => {
            let beside = match mapping {
                Some(_) => None,
                None => Mapping::read_beside(path)?,
            };
            return by_content(&bytes()?, &name, mapping.or(beside.as_ref()), &extension);
        }
        _ => {
            return Err(MetrologyError::Extension {
                file: name,
                found: extension_found(&extension),
            });
        }
    };
    Ok(Content::Measurement(Box::new(measurement)))
}

fn by_content(
    bytes: &[u8],
    name: &str,
    mapping: Option<&Mapping>,
    extension: &str,
) -> Result<Content, MetrologyError> {
    let measured = |m: Measurement| Content::Measurement(Box::new(m));
    let (text, _) = decode(bytes, name)?;
    let wrong =
        |found, expected| MetrologyError::WrongMapping { file: name.to_owned(), found, expected };
    if is_log(&text) {
        let log = parse_camonitor(bytes, name)?;
        return match mapping {
            Some(Mapping::Channels(channels)) => readings_at_dwells(&log, channels).map(measured),
            Some(Mapping::Columns(_)) => {
                Err(wrong("`columns`", "`channels`: the file is a log of camonitor"))
            }
            None => Ok(Content::Log(Box::new(log))),
        };
    }
    if is_report(&text) {
        return parse_keysight_report(bytes, name).map(measured);
    }
    match mapping {
        Some(Mapping::Columns(columns)) => {
            return parse_table_with(bytes, name, columns).map(measured);
        }
        Some(Mapping::Channels(_)) => {
            return Err(wrong("`channels`", "`columns`: the file is no log of camonitor"));
        }
        None => {}
    }
    if looks_like_circle(&text, name) {
        let (line, first) = first_line(&text).unwrap_or((1, ""));
        let expected = "readings at targets: this looks like a circle, which `volcomp iso230 --part 4` evaluates";
        return Err(Place::new(name, line).wrong_kind(quoted(first), expected));
    }
    if extension == "csv" {
        return parse_csv(bytes, name).map(measured);
    }
    let Some((line, first)) = first_line(&text) else {
        return Err(MetrologyError::Empty {
            file: name.into(),
            expected: "a report, a log or a table".into(),
        });
    };
    // A `.txt` file may contain a table with the heads of the plain CSV format.
    let lower = first.to_lowercase();
    if lower.contains("target") && lower.contains("deviation") {
        return parse_csv(bytes, name).map(measured);
    }
    let expected = "a report of a 5529 or 5530 laser, a log of camonitor, the header `target,run,direction,deviation`, or `columns` that name the columns";
    Err(Place::new(name, line).wrong_kind(quoted(first), expected))
}

fn file_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().display().to_string()
}

fn bytes_of(path: &Path, name: &str) -> Result<Vec<u8>, MetrologyError> {
    let unreadable = |source| MetrologyError::Unreadable { file: name.into(), source };
    let limit = LIMIT_MIB * 1024 * 1024;
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(unreadable)?;
    file.take(limit + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > limit {
        return Err(MetrologyError::TooLarge { file: name.into(), limit_mib: LIMIT_MIB });
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
