//! What went wrong, said on standard error, and the exit status.

use std::{fmt::Display, io::IsTerminal, path::Path};

use miette::{LabeledSpan, MietteDiagnostic, NamedSource, Report};
use volcomp_calibrate::CalibrateError;
use volcomp_document::InputError;
use volcomp_model::ModelError;

/// Why the program stops.
#[derive(Debug)]
pub(crate) enum Failure {
    /// The input or the call is wrong: status 2.
    Input(String),
    /// A place in a file is wrong: status 2, shown with its line on a terminal.
    Place(Box<InputError>),
    /// The work failed: status 1.
    Work(String),
}

impl Failure {
    pub(crate) fn input(message: impl Display) -> Self {
        Self::Input(message.to_string())
    }

    /// A file could not be read or written.
    pub(crate) fn work_on(path: &Path, error: &impl Display) -> Self {
        Self::Work(format!("{}: {error}", path.display()))
    }

    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Input(_) | Self::Place(_) => 2,
            Self::Work(_) => 1,
        }
    }

    /// One unbroken line, or on a terminal the place in the file with it.
    pub(crate) fn report(&self) {
        match self {
            Self::Place(place) if std::io::stderr().is_terminal() => {
                let label = LabeledSpan::at(place.span.clone(), "here");
                let diagnostic = MietteDiagnostic::new(place.to_string()).with_label(label);
                let source = NamedSource::new(&place.file, place.text.to_string());
                eprintln!("{:?}", Report::new(diagnostic).with_source_code(source));
            }
            Self::Place(place) => eprintln!("error: {place}"),
            Self::Input(message) | Self::Work(message) => eprintln!("error: {message}"),
        }
    }
}

impl From<ModelError> for Failure {
    fn from(error: ModelError) -> Self {
        match error {
            ModelError::Input(place) => Self::Place(Box::new(place)),
            other => Self::input(other),
        }
    }
}

impl From<CalibrateError> for Failure {
    fn from(error: CalibrateError) -> Self {
        match error {
            CalibrateError::Input(place) => Self::Place(Box::new(place)),
            CalibrateError::Machine(error) => error.into(),
            other => Self::input(other),
        }
    }
}
