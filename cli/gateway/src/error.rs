//! Why a gateway does not start, or not do what it is asked.

use volcomp_document::{InputError, ReadError};
use volcomp_model::ModelError;
use volcomp_port::DeviceError;

/// What is wrong.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GatewayError {
    /// A place in the configuration or the machine file.
    #[error(transparent)]
    Place(#[from] InputError),
    /// The machine file.
    #[error(transparent)]
    Model(ModelError),
    /// The configuration cannot be read as text.
    #[error(transparent)]
    Unreadable(#[from] ReadError),
    /// A device.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// A file that cannot be read.
    #[error("{file}: cannot be read: {source}")]
    Read {
        /// Which one.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// Configuration and machine do not fit together.
    #[error("{0}")]
    Unfit(String),
    /// Something of the operating system.
    #[error("{what}: {source}")]
    System {
        /// What was tried.
        what: String,
        /// Why it failed.
        source: std::io::Error,
    },
}

impl GatewayError {
    /// A failure of the operating system.
    pub fn system(what: impl Into<String>, source: std::io::Error) -> Self {
        Self::System {
            what: what.into(),
            source,
        }
    }

    /// 2: the call or a file is wrong; 1: the work failed.
    pub fn status(&self) -> u8 {
        match self {
            Self::Device(_) | Self::System { .. } => 1,
            _ => 2,
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
