//! Why something was not done.

use std::io;

use volcomp_document::{InputErrors, PrivateError, ReadError};
use volcomp_fleet::{LinkError, MachineId, NoConfiguration, NotADesired};
use volcomp_model::ModelError;
use volcomp_web::TlsError;

/// Every error of the centre but that of a [subnet](crate::discover::NotSearched).
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    #[error("the database: {0}")]
    Sqlite(#[from] rusqlite::Error),
    /// The file of the database cannot be created, or kept from others.
    #[error(
        "the database: {file}: {why}; expected a file that this program can keep to its owner (mode 600)"
    )]
    Database { file: String, why: io::Error },
    /// A document in the database was not written by this program.
    #[error("a document in the database: {0}")]
    Document(#[from] serde_json::Error),
    /// A newer program has changed the database.
    #[error(
        "the database has {found} steps of its schema, this program knows {known}: expected a program as new as the one that wrote it"
    )]
    Newer { found: u64, known: u64 },
    /// The change contradicts what is stored.
    #[error("{0}")]
    Conflict(String),
    /// A confirmation that would have no effect.
    #[error("nothing is confirmed: {0}")]
    NotConfirmed(String),
    #[error("found no {what} {name}")]
    Missing { what: &'static str, name: String },
    /// The model is for another kind of machine.
    #[error("{0}")]
    Misfit(String),
    #[error("{machine} has no model yet: expected a roll-out first")]
    NoModelYet { machine: MachineId },
    /// There is no such machine, or it has had one model alone.
    #[error("{machine}: found no model that it has had in force before the one that it has now")]
    NoWayBack { machine: MachineId },
    #[error(transparent)]
    Manifest(#[from] NotADesired),
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Read(#[from] ReadError),
    /// Places in the configuration.
    #[error(transparent)]
    Input(#[from] InputErrors),
    /// A secret cannot be read, or others may read it.
    #[error(transparent)]
    Private(#[from] PrivateError),
    #[error("{file}: {source}")]
    File { file: String, source: io::Error },
    #[error("random numbers: {0}")]
    Random(getrandom::Error),
    /// The configuration of the server cannot be written.
    #[error(transparent)]
    Server(#[from] NoConfiguration),
    #[error(transparent)]
    Tls(#[from] TlsError),
    #[error("the server: {0}")]
    Link(#[from] LinkError),
    #[error("a thread: {0}")]
    Thread(io::Error),
    #[error(
        "{0} has ended by itself, which it never should: see the log; what was not acknowledged comes again after a start"
    )]
    Ended(&'static str),
    #[error(transparent)]
    Io(#[from] io::Error),
    /// The input or the call is wrong.
    #[error("{0}")]
    Wrong(String),
    /// The work failed, or found something that needs attention.
    #[error("{0}")]
    Failed(String),
}

impl Error {
    /// The exit status: 2 where the configuration or the call is wrong, 1 where the work failed.
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

    /// Whether the database itself fails: a later try may succeed with the same data.
    pub(crate) fn is_of_database(&self) -> bool {
        matches!(
            self,
            Self::Sqlite(_) | Self::Database { .. } | Self::Document(_) | Self::Newer { .. }
        )
    }

    pub(crate) fn missing(what: &'static str, name: &(impl ToString + ?Sized)) -> Self {
        Self::Missing {
            what,
            name: name.to_string(),
        }
    }
}
