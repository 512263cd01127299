//! Errors at start-up and in typed commands.

use volcomp_document::InputError;
use volcomp_guard::barrier::SettingsError;
use volcomp_model::ModelError;

#[derive(Debug, thiserror::Error)]
pub(crate) enum SimError {
    /// An invalid option.
    #[error("{place}: found {found}, expected {expected}")]
    Input {
        place: String,
        found: String,
        expected: String,
    },
    /// A file cannot be read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        file: String,
        source: std::io::Error,
    },
    /// A file cannot be written.
    #[error("{file}: cannot be written: {source}")]
    Write {
        file: String,
        source: std::io::Error,
    },
    /// An error at a place in the program file.
    #[error(transparent)]
    Place(#[from] InputError),
    /// An invalid machine file of `--truth`.
    #[error("--truth: {0}")]
    Model(#[from] ModelError),
    /// Invalid settings of the barrier.
    #[error("the barrier: {0}")]
    Barrier(#[from] SettingsError),
    /// Invalid settings of the map look-up.
    #[error("--map-words: {0}")]
    Map(#[from] volcomp_tables::control::SettingsError),
    /// The simulator cannot listen on the address.
    #[error("--listen {address}: {source}")]
    Listen {
        address: String,
        source: std::io::Error,
    },
    /// Another operating system error.
    #[error("{what}: {source}")]
    System {
        what: &'static str,
        source: std::io::Error,
    },
}

impl SimError {
    /// Error for an invalid input with its place.
    pub(crate) fn input(
        place: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Input {
            place: place.into(),
            found: found.into(),
            expected: expected.into(),
        }
    }

    pub(crate) fn write(file: &str) -> impl FnOnce(std::io::Error) -> Self {
        let file = file.to_owned();
        move |source| Self::Write { file, source }
    }

    pub(crate) fn thread(source: std::io::Error) -> Self {
        let what = "a thread";
        Self::System { what, source }
    }

    /// Exit status: 2 if the arguments or a file are invalid, 1 if the operation failed.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Listen { source, .. } if source.kind() != std::io::ErrorKind::InvalidInput => 1,
            Self::System { .. } | Self::Write { .. } => 1,
            _ => 2,
        }
    }
}
