//! Why a gateway does not start, or does not do what it is asked.

use std::{fmt::Display, io, path::PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::{InputError, InputErrors, PrivateError, ReadError};
use volcomp_model::ModelError;
use volcomp_port::DeviceError;
use volcomp_runtime::{PlanError, StartError};
use volcomp_web::TlsError;

/// Why a gateway does not start, or does not do what it is asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
#[expect(missing_docs, reason = "`file` is a path, `source` the cause")]
pub enum GatewayError {
    /// A place in the configuration or the machine file.
    #[error(transparent)]
    Place(#[from] InputError),
    /// Everything that is wrong in a configuration.
    #[error(transparent)]
    Configuration(#[from] InputErrors),
    /// A machine file that does not make a machine.
    #[error(transparent)]
    Model(ModelError),
    /// The configuration cannot be read as text.
    #[error(transparent)]
    Unreadable(#[from] ReadError),
    /// The machine file cannot be read as text.
    #[error("{file}: machine: {source}")]
    MachineFile { file: String, source: ReadError },
    /// Controllers, machine and limits do not fit together.
    #[error("{file}: {source}")]
    Plan { file: String, source: PlanError },
    /// The configuration of a device is invalid; found without opening it.
    #[error("{file}: {source}")]
    DeviceConfig { file: String, source: DeviceError },
    /// A certificate that cannot be used or made.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// A line of the token file, from 1. The message never holds the token.
    #[error("{}:{line}: {source}", file.display())]
    Token {
        file: PathBuf,
        line: usize,
        source: TokenError,
    },
    /// A file with a secret that cannot be read, or that others may read.
    #[error(transparent)]
    Private(#[from] PrivateError),
    /// A file that cannot be read.
    #[error("{file}: cannot be read: {source}")]
    Read { file: String, source: io::Error },
    /// A device that cannot be opened.
    #[error(transparent)]
    Device(DeviceError),
    /// The control thread does not start.
    #[error(transparent)]
    Start(#[from] StartError),
    /// A barrier that cannot be set to the limits of a controller.
    #[error("{device}: a barrier cannot be set to these limits: {source}")]
    Barrier {
        device: String,
        source: volcomp_guard::barrier::SettingsError,
    },
    /// Something of the operating system.
    #[error("{what}: {source}")]
    System { what: String, source: io::Error },
    /// Any other reason, whose message is all there is to know of it.
    #[error("{0}")]
    Failed(Failure),
}

/// A failure in words: also the document on standard error when a call with `--json` fails.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Serialize, JsonSchema)]
#[error("{what}")]
pub struct Failure {
    /// The message in words.
    #[serde(rename = "error")]
    pub what: String,
    /// The exit status: 1 the work failed, 2 the configuration or the call is wrong.
    pub status: u8,
}

/// The reason why a line of a token file is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TokenError {
    /// A line that has not three words.
    #[error("found {0} words, expected NAME ROLE TOKEN")]
    Words(usize),
    /// A role that is not known.
    #[error("found another role, expected view, operate or engineer")]
    Role,
    /// A token that can be guessed.
    #[error(
        "expected a token of at least 128 bits: 32 hexadecimal digits or 22 other letters and digits"
    )]
    Short,
    /// A second token of one name.
    #[error("this name stands twice")]
    Twice,
}

impl GatewayError {
    /// A failure of the operating system.
    pub fn system(what: impl Into<String>, source: io::Error) -> Self {
        Self::System {
            what: what.into(),
            source,
        }
    }

    /// A file or a call that is wrong: exit status 2.
    pub(crate) fn invalid(what: impl Into<String>) -> Self {
        let what = what.into();
        Self::Failed(Failure { what, status: 2 })
    }

    /// Something wrong in a file: exit status 2.
    pub(crate) fn invalid_in(file: impl Display, what: impl Display) -> Self {
        Self::invalid(format!("{file}: {what}"))
    }

    /// Work that failed: exit status 1.
    pub(crate) fn failed(what: impl Into<String>) -> Self {
        let what = what.into();
        Self::Failed(Failure { what, status: 1 })
    }

    /// A configuration that does not say where a running gateway is to be asked.
    pub fn status_without(source: &Self) -> Self {
        Self::invalid(format!(
            "{source}; a running gateway tells its state without this file, too: volcomp-gateway status --listen ADDRESS, its address and port"
        ))
    }

    /// The message and the exit status.
    pub fn failure(&self) -> Failure {
        Failure {
            what: self.to_string(),
            status: self.status(),
        }
    }

    /// The exit status of the program: 2 when the call or a file is wrong, 1 when the work failed.
    pub fn status(&self) -> u8 {
        match self {
            Self::Failed(failure) => failure.status,
            Self::Device(_)
            | Self::Start(_)
            | Self::Tls(TlsError::Write { .. })
            | Self::System { .. } => 1,
            Self::Place(_)
            | Self::Configuration(_)
            | Self::Model(_)
            | Self::Unreadable(_)
            | Self::MachineFile { .. }
            | Self::Plan { .. }
            | Self::DeviceConfig { .. }
            | Self::Tls(_)
            | Self::Token { .. }
            | Self::Private(_)
            | Self::Read { .. }
            | Self::Barrier { .. } => 2,
        }
    }
}

impl From<ModelError> for GatewayError {
    fn from(error: ModelError) -> Self {
        match error {
            ModelError::Input(place) => Self::Place(place),
            other => Self::Model(other),
        }
    }
}
