//! Failures as Python exceptions, with their place in a file.

use std::{fmt::Display, io, path::Path};

use pyo3::{
    create_exception,
    exceptions::{PyOSError, PyValueError},
    prelude::*,
};
use volcomp_calibrate::CalibrateError;
use volcomp_identify::IdentifyError;
use volcomp_metrology::MetrologyError;
use volcomp_model::{
    ModelError,
    document::{InputError as FileError, ReadError},
};

create_exception!(
    volcomp,
    InputError,
    PyValueError,
    "An argument or the content of a file is invalid.\n\n`file`, `line` (from 1) and `key` (key or column) say where; each is None where it does not apply."
);

/// Why a call failed; becomes an exception once the interpreter is attached.
#[derive(Debug)]
pub(crate) enum Failure {
    /// Raised as `InputError`: the message, and the place in a file as far as it is known.
    Input { message: String, file: Option<String>, line: Option<usize>, key: Option<String> },
    /// Raised as `OSError`, or as the subclass for the error number of `source`.
    System { file: String, source: io::Error },
    /// An exception that Python code raised.
    Raised(PyErr),
}

/// Sets the default `None` of the attributes `file`, `line` and `key` of `InputError`.
pub(crate) fn set_defaults(py: Python<'_>) -> PyResult<()> {
    let class = py.get_type::<InputError>();
    for name in ["file", "line", "key"] {
        class.setattr(name, py.None())?;
    }
    Ok(())
}

impl Failure {
    /// An argument is invalid; the message names it.
    pub(crate) fn argument(message: impl Display) -> Self {
        Self::at(message, None, None, None)
    }

    /// A file is invalid as a whole; `what` follows its name in the message.
    pub(crate) fn in_file(path: &Path, what: impl Display) -> Self {
        let file = path.display().to_string();
        Self::at(format!("{file}: {what}"), Some(file), None, None)
    }

    pub(crate) fn system(path: &Path, source: io::Error) -> Self {
        Self::System { file: path.display().to_string(), source }
    }

    pub(crate) fn at(
        message: impl Display,
        file: Option<String>,
        line: Option<usize>,
        key: Option<String>,
    ) -> Self {
        Self::Input {
            message: message.to_string(),
            file,
            line,
            key: key.filter(|key| !key.is_empty()),
        }
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Raised(error) => error,
            Failure::System { file, source } => {
                let text = source.to_string();
                // The error number and the path of a temporary file do not help the user.
                let [number, path] = [" (os error", " at path "];
                let text = text.split(path).next().unwrap_or_default();
                let text = text.split(number).next().unwrap_or_default();
                match source.raw_os_error() {
                    Some(number) => PyOSError::new_err((number, text.to_owned(), file)),
                    // PyO3 chooses the subclass by the kind.
                    None => io::Error::new(source.kind(), format!("{file}: {text}")).into(),
                }
            }
            Failure::Input { message, file, line, key } => Python::attach(|py| {
                let error = InputError::new_err(message);
                let value = error.value(py);
                let set = (value.setattr("file", file))
                    .and_then(|()| value.setattr("line", line))
                    .and_then(|()| value.setattr("key", key));
                set.err().unwrap_or(error)
            }),
        }
    }
}

impl From<PyErr> for Failure {
    fn from(error: PyErr) -> Self {
        Self::Raised(error)
    }
}

impl From<FileError> for Failure {
    fn from(error: FileError) -> Self {
        let message = error.to_string();
        Self::at(message, Some(error.file), Some(error.line), Some(error.key))
    }
}

impl From<ReadError> for Failure {
    fn from(error: ReadError) -> Self {
        let message = error.to_string();
        match error {
            ReadError::System { file, source } => Self::System { file, source },
            ReadError::Encoding { file, .. } => Self::at(message, Some(file), None, None),
            _ => Self::argument(message),
        }
    }
}

impl From<ModelError> for Failure {
    fn from(error: ModelError) -> Self {
        match error {
            ModelError::Input(error) => error.into(),
            ModelError::Read(error) => error.into(),
            other => Self::argument(other),
        }
    }
}

impl From<MetrologyError> for Failure {
    fn from(error: MetrologyError) -> Self {
        let message = error.to_string();
        match error {
            MetrologyError::Unreadable { file, source } => Self::System { file, source },
            MetrologyError::Table(error) => (*error).into(),
            MetrologyError::Encoding(at)
            | MetrologyError::Kind(at)
            | MetrologyError::Structure(at)
            | MetrologyError::Number(at)
            | MetrologyError::Contradiction(at)
            | MetrologyError::Truncated(at) => {
                Self::at(message, Some(at.file), Some(at.line), Some(at.what))
            }
            MetrologyError::Directory { file }
            | MetrologyError::Extension { file, .. }
            | MetrologyError::TooLarge { file, .. }
            | MetrologyError::Empty { file, .. }
            | MetrologyError::NoTargets { file, .. }
            | MetrologyError::WrongMapping { file, .. } => {
                Self::at(message, Some(file), None, None)
            }
            _ => Self::argument(message),
        }
    }
}

impl From<IdentifyError> for Failure {
    fn from(error: IdentifyError) -> Self {
        let message = error.to_string();
        match error {
            IdentifyError::Input(error) => error.into(),
            IdentifyError::Machine(error) => error.into(),
            IdentifyError::Read(error) => error.into(),
            IdentifyError::NoSuchPlace { file, line, .. }
            | IdentifyError::Unexplained { file, line, .. } => {
                Self::at(message, Some(file), Some(line), None)
            }
            IdentifyError::FarRows { mut files } if files.len() == 1 => {
                let far = files.swap_remove(0);
                Self::at(message, Some(far.file), Some(far.line), None)
            }
            _ => Self::argument(message),
        }
    }
}

impl From<CalibrateError> for Failure {
    fn from(error: CalibrateError) -> Self {
        let message = error.to_string();
        match error {
            CalibrateError::Input(error) => error.into(),
            CalibrateError::Machine(error) => error.into(),
            CalibrateError::Read(error) => error.into(),
            CalibrateError::Measurement(error) => error.into(),
            CalibrateError::Identify(error) => error.into(),
            CalibrateError::Hash { file, source } => Self::system(&file, source),
            CalibrateError::Profile { file, .. } => {
                let file = file.display().to_string();
                Self::at(message, Some(file), None, None)
            }
            _ => Self::argument(message),
        }
    }
}
