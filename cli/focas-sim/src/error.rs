//! Why the simulator does not start, or refuses a typed command.

use volcomp_document::InputError;
use volcomp_guard::barrier::SettingsError;
use volcomp_model::ModelError;

/// Why the simulator does not start.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SimError {
    /// An option is wrong.
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
    /// A place in the program file is wrong.
    #[error(transparent)]
    Place(#[from] InputError),
    /// The machine file of `--truth` is wrong.
    #[error("--truth: {0}")]
    Model(#[from] ModelError),
    /// The barrier cannot be set as the options say.
    #[error("the barrier: {0}")]
    Barrier(#[from] SettingsError),
    /// The look-up cannot be set as the options say.
    #[error("--map-words: {0}")]
    Map(#[from] volcomp_tables::control::SettingsError),
    /// The simulator cannot listen on the address.
    #[error("--listen {address}: {source}")]
    Listen {
        address: String,
        source: std::io::Error,
    },
    /// The operating system refuses something else.
    #[error("{what}: {source}")]
    System {
        what: &'static str,
        source: std::io::Error,
    },
}

impl SimError {
    /// An input that is wrong at a place.
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

    /// A file cannot be written.
    pub(crate) fn write(file: &str) -> impl FnOnce(std::io::Error) -> Self {
        let file = file.to_owned();
        move |source| Self::Write { file, source }
    }

    /// The operating system gives no thread.
    pub(crate) fn thread(source: std::io::Error) -> Self {
        let what = "a thread";
        Self::System { what, source }
    }

    /// The exit status: 2 where the call or a file is wrong, 1 where the work failed.
    pub(crate) fn status(&self) -> u8 {
        match self {
            Self::Listen { source, .. } if source.kind() != std::io::ErrorKind::InvalidInput => 1,
            Self::System { .. } | Self::Write { .. } => 1,
            _ => 2,
        }
    }
}
