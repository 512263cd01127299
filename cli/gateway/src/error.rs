//! Errors of the gateway.

use std::{fmt::Display, io, path::PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::{InputError, InputErrors, PrivateError, ReadError};
use volcomp_model::ModelError;
use volcomp_port::DeviceError;
use volcomp_runtime::{PlanError, StartError};
use volcomp_web::TlsError;

/// An error of the gateway: at start-up, or while it executes a command.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GatewayError {
    /// An error at a position of the configuration or the machine file.
    #[error(transparent)]
    Place(#[from] InputError),
    /// All errors of a configuration file.
    #[error(transparent)]
    Configuration(#[from] InputErrors),
    /// The machine file does not define a valid machine.
    #[error(transparent)]
    Model(ModelError),
    /// The configuration is not readable text.
    #[error(transparent)]
    Unreadable(#[from] ReadError),
    /// The machine file is not readable text.
    #[error("{file}: machine: {source}")]
    MachineFile { file: String, source: ReadError },
    /// Controllers, machine and limits do not match.
    #[error("{file}: {source}")]
    Plan { file: String, source: PlanError },
    /// The configuration of a device is invalid; detected without opening it.
    #[error("{file}: {source}")]
    DeviceConfig { file: String, source: DeviceError },
    /// A certificate is unusable or cannot be created.
    #[error(transparent)]
    Tls(#[from] TlsError),
    /// A line of the token file, counted from 1, is invalid. The message never contains the token.
    #[error("{}:{line}: {source}", file.display())]
    Token { file: PathBuf, line: usize, source: TokenError },
    /// A file with a secret is unreadable, or readable by other users.
    #[error(transparent)]
    Private(#[from] PrivateError),
    #[error("{file}: cannot be read: {source}")]
    Read { file: String, source: io::Error },
    #[error(transparent)]
    Device(DeviceError),
    #[error(transparent)]
    Start(#[from] StartError),
    #[error("{device}: a barrier cannot be set to these limits: {source}")]
    Barrier { device: String, source: volcomp_guard::barrier::SettingsError },
    /// An operating-system call failed.
    #[error("{what}: {source}")]
    System { what: String, source: io::Error },
    /// Any other error, described only by its message.
    #[error("{0}")]
    Failed(Failure),
}

/// A failure with its message; also the document on standard error when a call with `--json` fails.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error, Serialize, JsonSchema)]
#[error("{what}")]
pub struct Failure {
    /// The message, in English.
    #[serde(rename = "error")]
    pub what: String,
    /// Exit status: 1 if the operation failed, 2 if the configuration or the call is invalid.
    pub status: u8,
}

/// Why a line of a token file is rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TokenError {
    /// The line does not have three words.
    #[error("found {0} words, expected NAME ROLE TOKEN")]
    Words(usize),
    /// The second word is not a role.
    #[error("found another role, expected view, operate or engineer")]
    Role,
    /// The token has less than 128 bits.
    #[error(
        "expected a token of at least 128 bits: 32 hexadecimal digits or 22 other letters and digits"
    )]
    Short,
    /// The name appears more than once.
    #[error("duplicate name")]
    Twice,
}

impl GatewayError {
    /// Wraps an operating-system error with the object it concerns.
    pub fn system(what: impl Into<String>, source: io::Error) -> Self {
        Self::System { what: what.into(), source }
    }

    /// Creates an error with exit status 2.
    pub(crate) fn invalid(what: impl Into<String>) -> Self {
        let what = what.into();
        Self::Failed(Failure { what, status: 2 })
    }

    /// Creates an error about `file` with exit status 2.
    pub(crate) fn invalid_in(file: impl Display, what: impl Display) -> Self {
        Self::invalid(format!("{file}: {what}"))
    }

    /// Creates an error with exit status 1.
    pub(crate) fn failed(what: impl Into<String>) -> Self {
        let what = what.into();
        Self::Failed(Failure { what, status: 1 })
    }

    /// Error for a configuration that does not give the address of a running gateway. The message names the option
    /// `--listen`, which replaces the file.
    pub fn running_without(source: &Self) -> Self {
        Self::invalid(format!(
            "{source}; a running gateway is also reached without this file: --listen ADDRESS, its address and port"
        ))
    }

    /// The message and the exit status.
    pub fn failure(&self) -> Failure {
        Failure { what: self.to_string(), status: self.status() }
    }

    /// Exit status of the program: 2 for an invalid call or file, 1 for a failed operation.
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
