//! Failures, their output on standard error, and the exit status.

use std::{fmt::Display, io::IsTerminal, path::Path};

use anstyle::{AnsiColor, Style};
use miette::{LabeledSpan, MietteDiagnostic, NamedSource, Report};
use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::CalibrateError;
use volcomp_document::{InputError, ReadError};
use volcomp_identify::IdentifyError;
use volcomp_metrology::MetrologyError;
use volcomp_model::ModelError;

const ERROR: Style = AnsiColor::Red.on_default().bold();

#[derive(Debug)]
pub(crate) enum Failure {
    /// The command line is invalid: status 2.
    Call(String),
    /// The value of an option or the content of a file is invalid: status 2.
    Input(String),
    /// A file is invalid as a whole or at a line: status 2.
    File(Box<FileFailure>),
    /// A TOML file is invalid at a position: status 2, shown with its line on a terminal.
    Place(Box<InputError>),
    /// The operation failed: status 1.
    Work(String),
    /// A file could not be written during the operation: status 1.
    WorkOn {
        file: String,
        /// The message of the operating system.
        message: String,
    },
}

#[derive(Debug)]
pub(crate) struct FileFailure {
    pub(crate) file: String,
    /// Line number, from 1; `None` if unknown.
    pub(crate) line: Option<u64>,
    /// Key or column; `None` if unknown.
    pub(crate) key: Option<String>,
    pub(crate) message: String,
}

/// The document on standard error of a call with `--json` that fails.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct FailureDocument {
    error: Error,
}

/// The error. Keys that do not apply are missing.
#[derive(Debug, Serialize, JsonSchema)]
struct Error {
    kind: Kind,
    /// The message, including found and expected value.
    message: String,
    /// The invalid file.
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<String>,
    /// Line in `file`, from 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    line: Option<u64>,
    /// Key or column in `file`.
    #[serde(skip_serializing_if = "Option::is_none")]
    key: Option<String>,
}

/// Kind of error, which determines the exit status.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
enum Kind {
    /// The command line is invalid: exit status 2.
    Call,
    /// The value of an option or the content of a file is invalid: exit status 2.
    Input,
    /// The operation failed: exit status 1.
    Work,
}

impl Failure {
    pub(crate) fn input(message: impl Display) -> Self {
        Self::Input(message.to_string())
    }

    /// Creates a failure of a file as a whole. `what` follows the file name in the message.
    pub(crate) fn in_file(path: &Path, what: impl Display) -> Self {
        let file = path.display().to_string();
        Self::File(Box::new(FileFailure {
            message: format!("{file}: {what}"),
            file,
            line: None,
            key: None,
        }))
    }

    /// Creates a failure of a line of a file. `key` names the column; an empty key means the whole line.
    pub(crate) fn in_line(path: &Path, line: u64, key: &str, what: impl Display) -> Self {
        let file = path.display().to_string();
        let column = if key.is_empty() { String::new() } else { format!("{key}: ") };
        Self::File(Box::new(FileFailure {
            message: format!("{file}:{line}: {column}{what}"),
            file,
            line: Some(line),
            key: (!key.is_empty()).then(|| key.to_owned()),
        }))
    }

    pub(crate) fn work_on(path: &Path, error: &impl Display) -> Self {
        Self::WorkOn { file: path.display().to_string(), message: error.to_string() }
    }

    pub(crate) fn status(&self) -> u8 {
        match self.kind() {
            Kind::Call | Kind::Input => 2,
            Kind::Work => 1,
        }
    }

    fn kind(&self) -> Kind {
        match self {
            Self::Call(_) => Kind::Call,
            Self::Input(_) | Self::File(_) | Self::Place(_) => Kind::Input,
            Self::Work(_) | Self::WorkOn { .. } => Kind::Work,
        }
    }

    pub(crate) fn message(&self) -> String {
        match self {
            Self::Call(message) | Self::Input(message) | Self::Work(message) => message.clone(),
            Self::File(failure) => failure.message.clone(),
            Self::Place(place) => place.to_string(),
            Self::WorkOn { file, message } => format!("{file}: {message}"),
        }
    }

    fn document(&self) -> FailureDocument {
        let (file, line, key) = match self {
            Self::Call(_) | Self::Input(_) | Self::Work(_) => (None, None, None),
            Self::File(failure) => (Some(failure.file.clone()), failure.line, failure.key.clone()),
            Self::Place(place) => (
                Some(place.file.clone()),
                Some(place.line as u64),
                Some(place.key.clone()).filter(|key| !key.is_empty()),
            ),
            Self::WorkOn { file, .. } => (Some(file.clone()), None, None),
        };
        FailureDocument {
            error: Error { kind: self.kind(), message: self.message(), file, line, key },
        }
    }

    /// Writes the failure to standard error: as JSON, as one unwrapped line, or, on a terminal, with the position in
    /// the file.
    pub(crate) fn report(&self, json: bool) {
        if json {
            // Serialization cannot fail. If it did, the message would be printed instead.
            let document = serde_json::to_string(&self.document());
            eprintln!("{}", document.unwrap_or_else(|_| self.message()));
            return;
        }
        match self {
            Self::Place(place) if std::io::stderr().is_terminal() => {
                let label = LabeledSpan::at(place.span.clone(), "here");
                let diagnostic = MietteDiagnostic::new(place.to_string()).with_label(label);
                let source = NamedSource::new(&place.file, place.text.to_string());
                eprintln!("{:?}", Report::new(diagnostic).with_source_code(source));
            }
            _ => anstream::eprintln!("{ERROR}error:{ERROR:#} {}", self.message()),
        }
    }
}

impl From<InputError> for Failure {
    fn from(place: InputError) -> Self {
        Self::Place(Box::new(place))
    }
}

impl From<ReadError> for Failure {
    fn from(error: ReadError) -> Self {
        let message = error.to_string();
        let (ReadError::System { file, .. } | ReadError::Encoding { file, .. }) = error else {
            return Self::Input(message);
        };
        Self::File(Box::new(FileFailure { file, line: None, key: None, message }))
    }
}

impl From<ModelError> for Failure {
    fn from(error: ModelError) -> Self {
        match error {
            ModelError::Input(place) => place.into(),
            ModelError::Read(error) => error.into(),
            other => Self::input(other),
        }
    }
}

impl From<CalibrateError> for Failure {
    fn from(error: CalibrateError) -> Self {
        match error {
            CalibrateError::Input(place) => place.into(),
            CalibrateError::Machine(error) => error.into(),
            CalibrateError::Read(error) => error.into(),
            CalibrateError::Measurement(error) => error.into(),
            CalibrateError::Identify(error) => error.into(),
            other => Self::input(other),
        }
    }
}

impl From<IdentifyError> for Failure {
    fn from(error: IdentifyError) -> Self {
        match error {
            IdentifyError::Input(place) => place.into(),
            IdentifyError::Machine(error) => error.into(),
            IdentifyError::Read(error) => error.into(),
            other => Self::input(other),
        }
    }
}

impl From<MetrologyError> for Failure {
    /// Reports an unreadable file as invalid input, because the user named the file on the command line.
    fn from(error: MetrologyError) -> Self {
        let message = error.to_string();
        let (file, line, key) = match error {
            MetrologyError::Encoding(at)
            | MetrologyError::Kind(at)
            | MetrologyError::Structure(at)
            | MetrologyError::Number(at) => (at.file, Some(at.line as u64), Some(at.what)),
            MetrologyError::Unreadable { file, .. }
            | MetrologyError::Directory { file }
            | MetrologyError::Extension { file, .. }
            | MetrologyError::TooLarge { file, .. }
            | MetrologyError::Empty { file, .. } => (file, None, None),
            MetrologyError::Table(place) => return Self::Place(place),
            _ => return Self::Input(message),
        };
        Self::File(Box::new(FileFailure { file, line, key, message }))
    }
}
