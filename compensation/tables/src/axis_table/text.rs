//! Text files of tables: their format, the parsing and formatting of their numbers, and the positions of errors in
//! them.

use core::fmt;
use core::str::FromStr;

use volcomp_document::InputError;
use volcomp_model::ModelError;
use volcomp_vocabulary::Displacement;

use crate::TablesError;

/// Format of table files, by the control or software that reads them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Format {
    /// CSV, the format of volcomp.
    Csv,
    /// LinuxCNC, COMP_FILE_TYPE 0: nominal, actual forward, actual backward.
    Linuxcnc,
    /// LinuxCNC, COMP_FILE_TYPE 1: nominal, trim forward, trim backward.
    LinuxcncType1,
    /// SINUMERIK 840D: $AA_ENC_COMP and $AN_CEC.
    Siemens840d,
    /// HEIDENHAIN TNC 640: .com and .cma.
    HeidenhainTnc640,
    /// FANUC pitch error compensation as a parameter file.
    Fanuc,
    /// TwinCAT TF5280, volumetric compensation: the ISG CSV.
    IsgCsv,
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("found format `{found}`, expected one of: {}", Format::ALL.map(Format::name).join(", "))]
pub struct UnknownFormat {
    /// The unknown name.
    pub found: String,
}

impl Format {
    /// All formats, in the order in which messages list them.
    pub const ALL: [Self; 7] = [
        Self::Csv,
        Self::Linuxcnc,
        Self::LinuxcncType1,
        Self::Siemens840d,
        Self::HeidenhainTnc640,
        Self::IsgCsv,
        Self::Fanuc,
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Csv => "csv",
            Self::Linuxcnc => "linuxcnc",
            Self::LinuxcncType1 => "linuxcnc-type1",
            Self::Siemens840d => "siemens-840d",
            Self::HeidenhainTnc640 => "heidenhain",
            Self::Fanuc => "fanuc",
            Self::IsgCsv => "isg-csv",
        }
    }

    pub(crate) fn holds_errors(self) -> bool {
        self == Self::IsgCsv
    }

    /// Whether files of the format can contain comments; otherwise the facts are written to a separate file.
    pub fn has_comments(self) -> bool {
        matches!(self, Self::Csv | Self::Siemens840d | Self::IsgCsv)
    }

    /// Sign convention of the numbers in files of the format.
    pub fn sign(self) -> &'static str {
        match self {
            Self::Csv => {
                "a value is the deviation, actual - commanded of the output axis, in um (linear) or urad (rotary); positions are in mm or deg"
            }
            Self::Linuxcnc => {
                "a line is nominal, actual after positive motion, actual after negative motion; the control adds nominal - actual to the motor's command; mm or deg"
            }
            Self::LinuxcncType1 => {
                "a line is nominal, trim after positive motion, trim after negative motion; trim = commanded - actual, which the control adds to the motor's command; mm or deg"
            }
            Self::Siemens840d => {
                "a value is actual - commanded, in mm or deg: a positive value moves the axis in its negative direction"
            }
            Self::HeidenhainTnc640 => "a value is actual - commanded, in mm or deg",
            Self::Fanuc => {
                "the value of a point is the step of -(actual - commanded) from the point before, in detection units times the magnification"
            }
            Self::IsgCsv => {
                "a value is the error motion of the tool side relative to the workpiece side (ISO 230-1 names), in mm or rad; positions are in mm or deg"
            }
        }
    }

    /// Evidence for the sign. No format was tested on a machine; the LinuxCNC formats were tested
    /// in LinuxCNC with simulated drives.
    pub fn trust(self) -> &'static str {
        match self {
            Self::Csv => "Sign proven by definition: this is the format of volcomp itself.",
            Self::Linuxcnc | Self::LinuxcncType1 => {
                "Sign proven on a running LinuxCNC 2.9 with simulated drives and by its source text (usrmotintf.cc, control.c), not on a machine."
            }
            Self::Siemens840d => {
                "$AA_ENC_COMP: sign proven by an independent public program that writes it; a manual says the same; not on a machine. \
                 $AN_CEC: sign unproven: try with one small known value first."
            }
            Self::HeidenhainTnc640 => {
                "Sign unproven: try with one small known value first. Form of the file by public programs and a manual."
            }
            Self::Fanuc => {
                "Sign proven by one independent public program that writes such values, not on a machine. Numbering of the data (N10000 + point), \
                 the unit of 3624 and 3625 and the place of the data for negative motion are from memory: unproven, compare with a file that your \
                 control has put out, and try with one small known value first."
            }
            Self::IsgCsv => {
                "Sign unproven: try with one small known value first. Above all: whether an error of an axis that carries the workpiece is meant as its \
                 own motion, which has the other sign."
            }
        }
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Format {
    type Err = UnknownFormat;

    fn from_str(text: &str) -> Result<Self, UnknownFormat> {
        let named = Self::ALL.into_iter().find(|format| format.name() == text);
        named.ok_or_else(|| UnknownFormat { found: text.to_owned() })
    }
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TextFile {
    /// File name; without folders if it is to be written.
    pub name: String,
    pub text: String,
}

impl TextFile {
    /// File name after the last slash or backslash.
    pub(crate) fn base(&self) -> &str {
        self.name.rsplit(['/', '\\']).next().unwrap_or(&self.name)
    }

    /// Position of a line, counted from 1.
    pub(crate) fn at(&self, line: usize) -> FilePosition<'_> {
        FilePosition { file: self, line: Some(line) }
    }

    pub(crate) fn whole(&self) -> FilePosition<'_> {
        FilePosition { file: self, line: None }
    }
}

/// Line of a file, or the whole file, to which an error or a warning refers.
#[derive(Clone, Copy)]
pub(crate) struct FilePosition<'a> {
    pub(crate) file: &'a TextFile,
    pub(crate) line: Option<usize>,
}

impl FilePosition<'_> {
    pub(crate) fn error(
        self,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> ExchangeError {
        ExchangeError::Line(LineError {
            file: self.file.name.clone(),
            line: self.line,
            found: found.into(),
            expected: expected.into(),
        })
    }

    /// Creates the error for a file with more lines of values than the control accepts.
    pub(crate) fn too_many(self, most: usize) -> ExchangeError {
        self.error(format!("a line {}", most + 1), format!("at most {most}"))
    }

    pub(crate) fn warning(self, text: impl Into<String>) -> Warning {
        Warning { file: self.file.name.clone(), line: self.line, text: text.into() }
    }
}

/// An anomaly in a file that was read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {text}", line.map_or_else(String::new, |line| format!(":{line}")))]
pub struct Warning {
    pub file: String,
    /// Line, counted from 1; `None` for the whole file.
    pub line: Option<usize>,
    /// The anomaly and its treatment.
    pub text: String,
}

/// Maximum magnitude of a position or deviation in a file.
const LARGEST: f64 = 1e9;

/// Parses a finite number of plausible magnitude; `-0.000` becomes 0.
pub(crate) fn number(text: &str) -> Option<f64> {
    let number: f64 = text.trim().parse().ok()?;
    let sane = text.bytes().any(|byte| byte.is_ascii_digit()) && number.abs() <= LARGEST;
    sane.then_some(number + 0.0)
}

/// Formats a number with this many decimals, never as `-0`.
pub(crate) fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|byte| matches!(byte, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

/// Formats a number with at most this many decimals, without trailing zeros.
pub(crate) fn short(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if !text.contains('.') {
        return text;
    }
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

pub(crate) fn signed(value: f64, decimals: usize) -> String {
    let text = fixed(value, decimals);
    if text.starts_with('-') { text } else { format!("+{text}") }
}

/// Rounds to a whole number; `None` if it is out of the range of the files.
pub(crate) fn whole(value: f64) -> Option<i64> {
    let rounded = value.round();
    #[expect(clippy::cast_possible_truncation, reason = "checked beside it")]
    (rounded.abs() <= 1e15).then_some(rounded as i64)
}

/// An invalid line of a file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: found {found}, expected {expected}", line.map_or_else(String::new, |line| format!(":{line}")))]
pub struct LineError {
    pub file: String,
    /// Line, counted from 1; `None` for the whole file.
    pub line: Option<usize>,
    /// Text in the file that is invalid.
    pub found: String,
    /// Description of valid text.
    pub expected: String,
}

/// Reasons why tables cannot be computed, written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExchangeError {
    /// The model cannot be evaluated.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A line of a file is invalid.
    #[error(transparent)]
    Line(#[from] LineError),
    /// A cell of a CSV file is invalid.
    #[error(transparent)]
    Cell(#[from] Box<InputError>),
    /// An option has an invalid value.
    #[error("{what}: found {found}, expected {expected}")]
    InvalidOption { what: String, found: String, expected: String },
    #[error("{what} is {found:.1}, expected at most {limit}: check the units in the machine file")]
    BeyondLimit { what: String, found: Displacement, limit: Displacement },
    /// A value in a file, or in tables to be written, is implausible for a machine tool.
    #[error("{}{what} is {found:.1}, expected at most {most}", if files.is_empty() { String::new() } else { format!("{}: ", files.join(", ")) })]
    Implausible {
        /// Names of the files that were read; empty if the tables were to be written.
        files: Vec<String>,
        what: String,
        found: Displacement,
        most: Displacement,
    },
    /// The format cannot represent the data.
    #[error("{format}: {what}: found {found}, expected {expected}")]
    NotRepresentable { format: Format, what: String, found: String, expected: String },
    /// Tables are missing or invalid, or cannot be converted to curves of a machine file.
    #[error("{0}")]
    NoCurves(String),
}

impl ExchangeError {
    pub(crate) fn not_representable(
        format: Format,
        what: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::NotRepresentable {
            format,
            what: what.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub(crate) fn option(
        what: impl Into<String>,
        found: &impl ToString,
        expected: impl Into<String>,
    ) -> Self {
        Self::InvalidOption {
            what: what.into(),
            found: found.to_string(),
            expected: expected.into(),
        }
    }
}

impl From<TablesError> for ExchangeError {
    fn from(error: TablesError) -> Self {
        match error {
            TablesError::Model(error) => Self::Model(error),
            other => Self::NoCurves(other.to_string()),
        }
    }
}

impl From<InputError> for ExchangeError {
    fn from(error: InputError) -> Self {
        Self::Cell(Box::new(error))
    }
}
