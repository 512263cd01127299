//! The SQLite file: opening it, and helpers for statements with parameters `?1`, `?2`, … whose rows mostly hold JSON documents.

use std::{
    fs,
    io::ErrorKind,
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::Path,
    thread,
    time::{Duration, Instant},
};

use crate::Error;
use rusqlite::{Connection, ErrorCode, Params, Row, types::Type};
use serde::de::DeserializeOwned;
use volcomp_fleet::MachineId;

/// Timeout for a lock held by another program, such as the command line.
const BUSY: Duration = Duration::from_secs(30);
const RETRY_INTERVAL: Duration = Duration::from_millis(10);
const MAX_PREPARED: usize = 128;

/// Executes a statement and returns the number of changed rows.
pub(crate) fn execute(
    database: &Connection,
    sql: &str,
    values: impl Params,
) -> Result<usize, Error> {
    Ok(database.prepare_cached(sql)?.execute(values)?)
}

/// Rows of a query, each converted by `read`.
pub(crate) fn rows<T>(
    database: &Connection,
    sql: &str,
    values: impl Params,
    read: impl FnMut(&Row<'_>) -> Result<T, Error>,
) -> Result<Vec<T>, Error> {
    let mut statement = database.prepare_cached(sql)?;
    statement.query_and_then(values, read)?.collect()
}

pub(crate) fn first<T>(
    database: &Connection,
    sql: &str,
    values: impl Params,
    read: impl FnMut(&Row<'_>) -> Result<T, Error>,
) -> Result<Option<T>, Error> {
    let mut statement = database.prepare_cached(sql)?;
    let mut rows = statement.query_and_then(values, read)?;
    rows.next().transpose()
}

/// Parsed documents in the first column of a query.
pub(crate) fn documents<T: DeserializeOwned>(
    database: &Connection,
    sql: &str,
    values: impl Params,
) -> Result<Vec<T>, Error> {
    rows(database, sql, values, |row| json(row, 0))
}

/// Parsed document in the first row of a query.
pub(crate) fn document<T: DeserializeOwned>(
    database: &Connection,
    sql: &str,
    values: impl Params,
) -> Result<Option<T>, Error> {
    first(database, sql, values, |row| json(row, 0))
}

/// Result of a query for a single number, such as a count.
pub(crate) fn number(database: &Connection, sql: &str, values: impl Params) -> Result<u64, Error> {
    let found = first(database, sql, values, |row| Ok(row.get(0)?))?;
    Ok(found.unwrap_or_default())
}

pub(crate) fn json<T: DeserializeOwned>(row: &Row<'_>, column: usize) -> Result<T, Error> {
    Ok(serde_json::from_str(&row.get::<_, String>(column)?)?)
}

/// A document of another program, stored unchanged. If this program cannot parse it as JSON (number out of range, unpaired surrogate), it is
/// returned as text with the reason.
pub(crate) fn json_or_text(row: &Row<'_>, column: usize) -> Result<serde_json::Value, Error> {
    let text: String = row.get(column)?;
    Ok(serde_json::from_str(&text).unwrap_or_else(|error| {
        let shown: String = text.chars().take(1000).collect();
        serde_json::json!({ "unreadable": shown, "why": error.to_string() })
    }))
}

pub(crate) fn machine(row: &Row<'_>, column: usize) -> Result<MachineId, Error> {
    let text: String = row.get(column)?;
    text.parse().map_err(|error| {
        rusqlite::Error::FromSqlConversionFailure(column, Type::Text, Box::new(error)).into()
    })
}

/// Opens the file, creating it if it does not exist. Only its owner may read it: it holds password hashes and models.
pub(super) fn open(path: &Path) -> Result<Connection, Error> {
    let failed = |why: std::io::Error| Error::Database {
        file: path.display().to_string(),
        why,
    };
    let mut options = fs::OpenOptions::new();
    // Create only, without opening an existing file: closing it would release the POSIX locks of connections that this program already has to it,
    // and another reading program would then delete the write-ahead log in use.
    match options.create_new(true).write(true).mode(0o600).open(path) {
        Err(why) if why.kind() != ErrorKind::AlreadyExists => return Err(failed(why)),
        _ => {}
    }
    if !fs::metadata(path).map_err(failed)?.is_file() {
        return Err(failed(std::io::Error::other("it is no regular file")));
    }
    let connection = Connection::open(path)?;
    connection.busy_timeout(BUSY)?;
    connection.set_prepared_statement_cache_capacity(MAX_PREPARED);
    begin_log(&connection)?;
    // SQLite has accepted it as a database; permissions of unrelated files stay unchanged.
    make_private(path).map_err(failed)?;
    // Acknowledged messages must survive a power failure: every commit is on disk when it returns.
    connection.execute_batch(
        "PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON; PRAGMA cache_size = -65536;",
    )?;
    Ok(connection)
}

/// Restricts the permissions of the database files to the owner.
fn make_private(path: &Path) -> std::io::Result<()> {
    for suffix in ["", "-wal", "-shm"] {
        let mut name = path.as_os_str().to_owned();
        name.push(suffix);
        let file = Path::new(&name);
        match file.metadata() {
            Ok(metadata) if metadata.permissions().mode() & 0o077 != 0 => {
                fs::set_permissions(file, fs::Permissions::from_mode(0o600))?;
                tracing::warn!("{}: others could read it: mode is now 600", file.display());
            }
            _ => {}
        }
    }
    Ok(())
}

/// Switches to write-ahead logging. If several programs open a new file at once, SQLite returns "busy" to all but one without waiting, so this
/// retries.
fn begin_log(connection: &Connection) -> Result<(), Error> {
    let until = Instant::now() + BUSY;
    loop {
        match connection.execute_batch("PRAGMA journal_mode = WAL") {
            Err(error)
                if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy)
                    && Instant::now() < until =>
            {
                thread::sleep(RETRY_INTERVAL);
            }
            done => return Ok(done?),
        }
    }
}
