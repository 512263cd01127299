use volcomp_document::InputError;
use volcomp_guard::barrier::SettingsError;
use volcomp_model::ModelError;

#[derive(Debug, thiserror::Error)]
pub(crate) enum SimError {
    #[error("{place}: found {found}, expected {expected}")]
    Input { place: String, found: String, expected: String },
    #[error("{file}: cannot be read: {source}")]
    Read { file: String, source: std::io::Error },
    #[error("{file}: cannot be written: {source}")]
    Write { file: String, source: std::io::Error },
    #[error(transparent)]
    Place(#[from] InputError),
    #[error("--truth: {0}")]
    Model(#[from] ModelError),
    #[error("the barrier: {0}")]
    Barrier(#[from] SettingsError),
    #[error("--map-words: {0}")]
    Map(#[from] volcomp_tables::control::SettingsError),
    #[error("--listen {address}: {source}")]
    Listen { address: String, source: std::io::Error },
    #[error("{what}: {source}")]
    System { what: &'static str, source: std::io::Error },
}

impl SimError {
    pub(crate) fn input(
        place: impl Into<String>,
        found: impl Into<String>,
        expected: impl Into<String>,
    ) -> Self {
        Self::Input { place: place.into(), found: found.into(), expected: expected.into() }
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
