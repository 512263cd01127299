use std::io;

use volcomp_document::{InputErrors, PrivateError, ReadError};
use volcomp_fleet::{DesiredError, LinkError, MachineId, ServerConfigError};
use volcomp_model::ModelError;
use volcomp_web::TlsError;

/// Every error of the centre except that of a [subnet](crate::discover::SubnetError).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    #[error("the database: {0}")]
    Sqlite(#[from] rusqlite::Error),
    /// The database file cannot be created, or its permissions cannot be restricted.
    #[error("the database: {file}: {why}; expected a file that can be created with mode 600")]
    Database { file: String, why: io::Error },
    /// A document in the database was not written by this program.
    #[error("a document in the database: {0}")]
    Document(#[from] serde_json::Error),
    /// A newer program has changed the database schema.
    #[error(
        "the database has schema version {found}, this program supports up to {known}: use a newer program"
    )]
    Newer { found: u64, known: u64 },
    /// The change contradicts the stored data.
    #[error("{0}")]
    Conflict(String),
    /// A confirmation that would have no effect.
    #[error("nothing is confirmed: {0}")]
    NotConfirmed(String),
    #[error("found no {what} {name}")]
    Missing { what: &'static str, name: String },
    /// The model does not match the structure and axes of the machine.
    #[error("{0}")]
    Misfit(String),
    #[error("{machine} has no model yet: expected a roll-out first")]
    NoModelYet { machine: MachineId },
    /// The machine does not exist, or has had only one model.
    #[error("{machine}: found no model that was active before the current one")]
    NoWayBack { machine: MachineId },
    #[error(transparent)]
    Manifest(#[from] DesiredError),
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Read(#[from] ReadError),
    #[error(transparent)]
    Input(#[from] InputErrors),
    /// A secret cannot be read, or other users can read it.
    #[error(transparent)]
    Private(#[from] PrivateError),
    #[error("{file}: {source}")]
    File { file: String, source: io::Error },
    #[error("random numbers: {0}")]
    Random(getrandom::Error),
    #[error(transparent)]
    Server(#[from] ServerConfigError),
    #[error(transparent)]
    Tls(#[from] TlsError),
    #[error("the server: {0}")]
    Link(#[from] LinkError),
    #[error("a thread: {0}")]
    Thread(io::Error),
    #[error(
        "{0} has ended unexpectedly: see the log; unacknowledged messages are redelivered after a restart"
    )]
    Ended(&'static str),
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The input or the arguments are invalid.
    #[error("{0}")]
    Wrong(String),
    /// The operation failed, or found something that needs attention.
    #[error("{0}")]
    Failed(String),
}

impl Error {
    /// Exit status: 2 if the configuration or the arguments are invalid, 1 if the operation failed.
    pub fn status(&self) -> u8 {
        match self {
            Self::File { source, .. } if source.kind() == io::ErrorKind::StorageFull => 1,
            Self::Conflict(_)
            | Self::Missing { .. }
            | Self::Misfit(_)
            | Self::NoWayBack { .. }
            | Self::Model(_)
            | Self::Read(_)
            | Self::Input(_)
            | Self::Private(_)
            | Self::File { .. }
            | Self::Random(_)
            | Self::Server(_)
            | Self::Tls(_)
            | Self::Wrong(_) => 2,
            Self::Sqlite(_)
            | Self::Database { .. }
            | Self::Document(_)
            | Self::Newer { .. }
            | Self::NotConfirmed(_)
            | Self::NoModelYet { .. }
            | Self::Manifest(_)
            | Self::Link(_)
            | Self::Thread(_)
            | Self::Ended(_)
            | Self::Io(_)
            | Self::Failed(_) => 1,
        }
    }

    /// True if the database itself failed: a retry may succeed with the same data.
    pub(crate) fn is_of_database(&self) -> bool {
        matches!(
            self,
            Self::Sqlite(_) | Self::Database { .. } | Self::Document(_) | Self::Newer { .. }
        )
    }

    pub(crate) fn missing(what: &'static str, name: &(impl ToString + ?Sized)) -> Self {
        Self::Missing { what, name: name.to_string() }
    }
}
