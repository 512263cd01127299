//! One connection to a server: made, made safe, and known to be gone.

use std::{collections::HashMap, error::Error, sync::Arc, time::Duration};

use tokio::runtime::Runtime;
use tokio_postgres::{Client, Statement, error::Severity, types::ToSql};
use tokio_postgres_rustls::MakeRustlsConnect;
use tokio_rustls::rustls::{
    ClientConfig, RootCertStore,
    crypto::ring,
    pki_types::{CertificateDer, pem::PemObject},
};

use super::place::PostgresPlace;
use crate::store::{StoreError, database::Value};

/// A statement that is not answered within this time never is: the connection is given up.
const ANSWERED_WITHIN: Duration = Duration::from_secs(90);
/// What every session is set to. Another program may write for so long; a session whose program is gone holds the others up
/// for no longer than that.
const SESSION: &str = "SET lock_timeout = '30s'; SET idle_in_transaction_session_timeout = '60s'";

/// Takes the next rows of a cursor.
const FETCH: &str = "FETCH 1000 FROM each";
/// Ends a cursor.
pub(super) const CLOSE: &str = "CLOSE each";

/// A connection, with the statements that it has ready.
pub(super) struct Link {
    client: Client,
    ready: HashMap<String, Statement>,
}

impl Link {
    /// Connects, and sees to it that what is committed is on disk.
    pub(super) fn open(runtime: &Runtime, place: &PostgresPlace) -> Result<Self, StoreError> {
        let mut config = place.config.clone();
        if let Some(file) = &place.password_file {
            config.password(volcomp_document::private::read(file)?.trim_end_matches(['\r', '\n']));
        }
        let tls = MakeRustlsConnect::new(tls(place)?);
        let gone = |why: String| StoreError::NotReached {
            place: place.to_string(),
            why,
        };
        let client = within(runtime, async {
            let (client, connection) = config.connect(tls).await?;
            // It is driven whenever a statement is waited for, and ends by itself with the server.
            runtime.spawn(connection);
            Ok(client)
        });
        let client = client.map_err(|error| gone(error.why()))?;
        let link = Self {
            client,
            ready: HashMap::new(),
        };
        within(runtime, link.make_safe(place))
            .map_err(|error| gone(error.why()))?
            .map(|()| link)
    }

    async fn make_safe(
        &self,
        place: &PostgresPlace,
    ) -> Result<Result<(), StoreError>, tokio_postgres::Error> {
        let setting =
            "SELECT current_setting('server_encoding'), current_setting('synchronous_commit'),
            current_setting('fsync')";
        let row = self.client.query_one(setting, &[]).await?;
        let (encoding, commit, sync): (String, String, String) =
            (row.try_get(0)?, row.try_get(1)?, row.try_get(2)?);
        if encoding != "UTF8" {
            return Ok(Err(StoreError::NotReached {
                place: place.to_string(),
                why: format!("found the encoding {encoding}, expected a database in UTF8"),
            }));
        }
        if sync == "off" {
            tracing::warn!(
                "{place}: fsync is off: what was acknowledged is lost when its computer loses power"
            );
        }
        self.client.batch_execute(SESSION).await?;
        if commit == "off" {
            // What was acknowledged to the server of the messages must outlive this one's end.
            let on = "SET synchronous_commit = on";
            self.client.batch_execute(on).await?;
        }
        Ok(Ok(()))
    }

    /// Executes several statements without parameters.
    pub(super) fn batch(&self, runtime: &Runtime, sql: &str) -> Result<(), Failed> {
        within(runtime, self.client.batch_execute(sql))
    }

    fn ready(&mut self, runtime: &Runtime, sql: &str) -> Result<Statement, Failed> {
        if let Some(statement) = self.ready.get(sql) {
            return Ok(statement.clone());
        }
        let statement = within(runtime, self.client.prepare(&translated(sql)))?;
        self.ready.insert(sql.to_owned(), statement.clone());
        Ok(statement)
    }

    /// Executes a statement: how many rows it has changed.
    pub(super) fn execute(
        &mut self,
        runtime: &Runtime,
        sql: &str,
        values: &[Value],
    ) -> Result<u64, Failed> {
        let statement = self.ready(runtime, sql)?;
        within(runtime, self.client.execute_raw(&statement, values))
    }

    /// Executes many statements, none of which waits for the answer to the one before; in their order.
    pub(super) fn execute_all(
        &mut self,
        runtime: &Runtime,
        all: &[(String, Vec<Value>)],
    ) -> Result<(), Failed> {
        let mut each = Vec::with_capacity(all.len());
        for (sql, values) in all {
            each.push((self.ready(runtime, sql)?, values));
        }
        let client = &self.client;
        let sent = each
            .iter()
            .map(|(statement, values)| client.execute_raw(statement, *values));
        within(runtime, futures_util::future::try_join_all(sent)).map(drop)
    }

    /// The rows of a question.
    pub(super) fn rows(
        &mut self,
        runtime: &Runtime,
        sql: &str,
        values: &[Value],
    ) -> Result<Vec<tokio_postgres::Row>, Failed> {
        let statement = self.ready(runtime, sql)?;
        let values: Vec<&(dyn ToSql + Sync)> = (values.iter())
            .map(|one| one as &(dyn ToSql + Sync))
            .collect();
        within(runtime, self.client.query(&statement, &values))
    }

    /// So many rows of a question, the next ones of a cursor that [`Self::declare`] has made.
    pub(super) fn fetch(&self, runtime: &Runtime) -> Result<Vec<tokio_postgres::Row>, Failed> {
        // Not kept ready: the next cursor of this name has other columns.
        within(runtime, self.client.query(FETCH, &[]))
    }

    /// Makes the cursor of a question. It ends with the transaction, or by [`CLOSE`].
    pub(super) fn declare(&self, runtime: &Runtime, sql: &str) -> Result<(), Failed> {
        self.batch(runtime, &format!("DECLARE each NO SCROLL CURSOR FOR {sql}"))
    }
}

/// `?1` is `$1` here; no text of ours has a question mark in it. Texts are compared byte by byte, as SQLite does: no language
/// of the server's changes an order, and no update of its tables makes an index wrong.
fn translated(sql: &str) -> String {
    let sql = sql.replace('?', "$");
    if sql.starts_with("CREATE TABLE") {
        sql.replace(" TEXT", " TEXT COLLATE \"C\"")
    } else {
        sql
    }
}

/// Why a statement was not done.
#[derive(Debug, thiserror::Error)]
pub(super) enum Failed {
    /// The server refuses it.
    #[error("{}", told(.0))]
    Refused(tokio_postgres::Error),
    /// The connection is gone.
    #[error("the connection was lost: {}", told(.0))]
    Lost(tokio_postgres::Error),
    /// The server does not answer.
    #[error("no answer within {} s, the connection is given up", ANSWERED_WITHIN.as_secs())]
    Silent,
}

impl Failed {
    /// The reason alone, of a connection that never was one.
    fn why(&self) -> String {
        match self {
            Self::Refused(error) | Self::Lost(error) => told(error),
            Self::Silent => self.to_string(),
        }
    }

    /// Whether the connection is of no use any more.
    pub(super) fn is_lost(&self) -> bool {
        !matches!(self, Self::Refused(_))
    }
}

/// An error with everything that caused it.
fn told(error: &tokio_postgres::Error) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(one) = cause {
        text = match text.as_str() {
            // Says nothing beside what the server says.
            "db error" => one.to_string(),
            _ => format!("{text}: {one}"),
        };
        cause = one.source();
    }
    text
}

/// Waits for an answer, and not for ever.
fn within<T>(
    runtime: &Runtime,
    work: impl Future<Output = Result<T, tokio_postgres::Error>>,
) -> Result<T, Failed> {
    let done = runtime.block_on(async { tokio::time::timeout(ANSWERED_WITHIN, work).await });
    done.map_err(|_| Failed::Silent)?.map_err(|error| {
        // What the server says of a statement leaves the connection as it was, unless it says that it ends it.
        let stays = (error.as_db_error()).is_some_and(|told| {
            !matches!(
                told.parsed_severity(),
                Some(Severity::Fatal | Severity::Panic)
            )
        });
        if stays {
            Failed::Refused(error)
        } else {
            Failed::Lost(error)
        }
    })
}

/// TLS as everywhere here: rustls with ring, the certificates of the system and those of the configuration.
fn tls(place: &PostgresPlace) -> Result<ClientConfig, StoreError> {
    let wrong = |why: String| StoreError::NotReached {
        place: place.to_string(),
        why,
    };
    let mut roots = RootCertStore::empty();
    if place.is_encrypted() {
        roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
    }
    if let Some(file) = &place.ca {
        let wrong = |why: &dyn std::fmt::Display| {
            wrong(format!(
                "{}: {why}, expected certificates, PEM",
                file.display()
            ))
        };
        let certificates = CertificateDer::pem_file_iter(file)
            .and_then(Iterator::collect::<Result<Vec<_>, _>>)
            .map_err(|e| wrong(&e))?;
        if certificates.is_empty() {
            return Err(wrong(&"found no certificate"));
        }
        for certificate in certificates {
            roots.add(certificate).map_err(|e| wrong(&e))?;
        }
    }
    let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|e| wrong(e.to_string()))?;
    Ok(builder.with_root_certificates(roots).with_no_client_auth())
}
