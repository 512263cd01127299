//! Why a command was not done.

use crate::{
    back::NoWayBack, config::ConfigError, engine::EngineError, issue::NotIssued, keys::KeyError,
    models::NoModel, store::StoreError,
};

/// Why a command was not done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CommandError {
    /// The configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A key or a secret.
    #[error(transparent)]
    Key(#[from] KeyError),
    /// A model.
    #[error(transparent)]
    Model(#[from] NoModel),
    /// What was asked for makes no sense.
    #[error("{0}")]
    Wrong(String),
    /// The server's configuration cannot be written.
    #[error(transparent)]
    Server(#[from] volcomp_fleet::NoConfiguration),
    /// The store.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The engine does not start.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// There is no way back.
    #[error(transparent)]
    Back(#[from] NoWayBack),
    /// Nothing was issued.
    #[error(transparent)]
    Issue(#[from] NotIssued),
    /// The certificate of the page.
    #[error(transparent)]
    Tls(#[from] volcomp_web::TlsError),
    /// The demonstration.
    #[error(transparent)]
    Demo(#[from] crate::demo::DemoError),
    /// A part of the running centre has ended by itself.
    #[error(
        "{0} has ended by itself, which it never should: see the log; what was not acknowledged comes again after a start"
    )]
    Ended(&'static str),
    /// The operating system.
    #[error(transparent)]
    Io(#[from] std::io::Error),
    /// Something was found that a person must look at; it has been printed.
    #[error("{0}")]
    Found(String),
}

impl CommandError {
    /// The exit status: 2 where the configuration or the call is wrong, 1 where the work failed.
    pub fn status(&self) -> u8 {
        match self {
            Self::Key(KeyError::File { source, .. })
                if source.kind() == std::io::ErrorKind::StorageFull =>
            {
                1
            }
            Self::Config(_)
            | Self::Key(_)
            | Self::Model(_)
            | Self::Wrong(_)
            | Self::Server(_)
            | Self::Back(
                NoWayBack::None { .. }
                | NoWayBack::Model(_)
                | NoWayBack::Store(StoreError::Conflict(_)),
            )
            | Self::Tls(_)
            | Self::Store(StoreError::Missing { .. } | StoreError::Conflict(_)) => 2,
            Self::Store(_)
            | Self::Back(NoWayBack::Store(_))
            | Self::Demo(_)
            | Self::Engine(_)
            | Self::Issue(_)
            | Self::Ended(_)
            | Self::Io(_)
            | Self::Found(_) => 1,
        }
    }
}
