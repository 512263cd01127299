use std::{fmt::Write as _, io::Read, path::Path};

use sha2::{Digest, Sha256};
use volcomp_vocabulary::{AxisName, ErrorName};

/// Measurements and methods from which the errors of a machine were determined, as recorded by the
/// program that determined them.
///
/// Provenance does not affect computations. Setting an error removes its provenance, so that it
/// never describes another curve.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Provenance {
    /// The version of volcomp that wrote the provenance.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
    /// The serial number of the machine that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// The date of the calibration as entered by the operator, `2026-11-26`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
    /// The errors that the measurements do not determine; results that depend on them are undecided.
    pub undecided: Vec<ErrorName>,
    /// The origin of each error, each error once.
    pub errors: Vec<Origin>,
}

/// The origin of one error.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Origin {
    /// The error motion or the location error.
    pub error: ErrorName,
    /// The method that determined the error: `smoothing B-spline`, `slopes of EXY and EYX`.
    pub method: String,
    /// The rule that selected the method.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rule: Option<String>,
    /// Root mean square of the mean readings minus the curve, both directions together, µm or µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residual: Option<f64>,
    /// Root mean square of the deviation of the curve at targets left out of its fit, µm or µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leave_one_out: Option<f64>,
    /// The files that contain the readings of the error.
    #[serde(rename = "files")]
    pub sources: Vec<Source>,
}

/// A file with readings of an error.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Source {
    /// Path of the file in the calibration file, relative to the latter.
    pub file: String,
    /// SHA-256 of the file, 64 lower-case hexadecimal digits.
    pub sha256: String,
    /// The number of runs used; both directions of a run count once.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub runs: Option<usize>,
    /// The number of targets.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub targets: Option<usize>,
    /// Positions of the other axes, mm or deg; axes at 0 are omitted.
    #[serde(serialize_with = "as_map")]
    #[cfg_attr(feature = "schema", schemars(with = "std::collections::BTreeMap<AxisName, f64>"))]
    pub at: Vec<(AxisName, f64)>,
    /// The date of the test as given in the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub date: Option<String>,
}

fn as_map<S: serde::Serializer>(at: &[(AxisName, f64)], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(at.iter().copied())
}

impl Provenance {
    /// True if nothing is recorded.
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// The origin of one error, if known.
    pub fn of(&self, error: ErrorName) -> Option<&Origin> {
        self.errors.iter().find(|origin| origin.error == error)
    }

    pub(crate) fn leave_undecided(&mut self, errors: impl IntoIterator<Item = ErrorName>) {
        self.undecided.extend(errors);
        self.undecided.sort_unstable();
        self.undecided.dedup();
    }

    /// A note on the errors that the measurements do not determine.
    pub fn note(&self) -> Option<String> {
        let names: Vec<String> = self.undecided.iter().map(ErrorName::to_string).collect();
        (!names.is_empty()).then(|| {
            format!(
                "the measurements that this file comes from do not confirm {}: figures that rest on them are undecided",
                names.join(" ")
            )
        })
    }

    /// Removes the entries of an error. The general entries are removed with the last origin.
    pub(crate) fn forget(&mut self, error: ErrorName) {
        let before = self.errors.len();
        self.errors.retain(|origin| origin.error != error);
        self.undecided.retain(|name| *name != error);
        if before > 0 && self.errors.is_empty() {
            *self = Self { undecided: core::mem::take(&mut self.undecided), ..Self::default() };
        }
    }

    /// The first reason why this provenance is invalid; `None` if it is valid. `stated` returns whether the machine has
    /// an error.
    pub(crate) fn refusal(&self, stated: impl Fn(ErrorName) -> bool) -> Option<ProvenanceRefusal> {
        if let Some(found) = self.date.as_ref().filter(|date| !is_date(date)) {
            return Some(ProvenanceRefusal::Date { found: found.clone() });
        }
        self.errors.iter().enumerate().find_map(|(place, origin)| {
            let error = origin.error;
            if self.errors[..place].iter().any(|o| o.error == error) {
                return Some(ProvenanceRefusal::Twice { error });
            }
            if !stated(error) {
                return Some(ProvenanceRefusal::NotStated { error });
            }
            let numbers = [origin.residual, origin.leave_one_out].into_iter().flatten();
            let mut wrong = numbers.filter(|x| !(*x >= 0.0 && x.is_finite()));
            if let Some(found) = wrong.next() {
                return Some(ProvenanceRefusal::Number { error, found });
            }
            let mut hashes = origin.sources.iter().map(|source| &source.sha256);
            let found = hashes.find(|hash| !is_sha256(hash))?.clone();
            Some(ProvenanceRefusal::Hash { error, found })
        })
    }
}

/// Why a provenance is rejected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ProvenanceRefusal {
    #[error("date: found `{found}`, expected a day of the calendar such as 2026-11-26")]
    Date { found: String },
    #[error("{error} appears twice")]
    Twice { error: ErrorName },
    #[error("found {error}, expected an error of the table [errors]")]
    NotStated { error: ErrorName },
    #[error("{error}: found {found}, expected a finite number of 0 or more")]
    Number { error: ErrorName, found: f64 },
    #[error("{error}: found `{found}` as sha256, expected 64 lower-case hexadecimal digits")]
    Hash { error: ErrorName, found: String },
}

fn is_sha256(text: &str) -> bool {
    let is_digit = |byte: u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
    text.len() == 64 && text.bytes().all(is_digit)
}

/// Whether a text is a date of the Gregorian calendar, `2026-11-26`.
pub fn is_date(text: &str) -> bool {
    let mut parts = text.split('-');
    let mut next = |digits: usize| {
        let part = parts.next()?;
        let fits = part.len() == digits && part.bytes().all(|byte| byte.is_ascii_digit());
        fits.then(|| part.parse::<u16>().ok()).flatten()
    };
    let (Some(year), Some(month), Some(day)) = (next(4), next(2), next(2)) else {
        return false;
    };
    let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let days = match month {
        1 | 3 | 5 | 7 | 8 | 10 | 12 => 31,
        4 | 6 | 9 | 11 => 30,
        2 if is_leap => 29,
        2 => 28,
        _ => 0,
    };
    (1..=days).contains(&day) && parts.next().is_none()
}

impl Source {
    /// A source named `name`, with the SHA-256 of the file at `path`.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn read(name: &str, path: &Path) -> std::io::Result<Self> {
        Ok(Self { file: name.to_owned(), sha256: sha256_of(path)?, ..Self::default() })
    }
}

/// SHA-256 of the bytes of a file, 64 lower-case hexadecimal digits.
///
/// # Errors
/// The file cannot be read.
pub fn sha256_of(path: &Path) -> std::io::Result<String> {
    let mut file = std::fs::File::open(path)?;
    let (mut hash, mut part) = (Sha256::new(), vec![0; 1 << 16]);
    loop {
        match file.read(&mut part)? {
            0 => return Ok(hexadecimal(&hash.finalize())),
            read => hash.update(part.get(..read).unwrap_or_default()),
        }
    }
}

/// Bytes as lower-case hexadecimal digits.
pub fn hexadecimal(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(2 * bytes.len());
    for byte in bytes {
        let _ = write!(text, "{byte:02x}"); // writing to a String cannot fail
    }
    text
}
