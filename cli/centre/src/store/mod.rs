//! The store: persistent data of the centre in an SQLite file.
//!
//! State: two connections to the database, one for writing and one for reading. Every function blocks on the disk, so
//! asynchronous programs call it on a blocking thread. Several programs may open the same database.
//!
//! Every function fails, without changing anything, if the file cannot be read, a row holds data that this program does
//! not write, or a change is rejected (full disk, locked by another program). Other errors are documented at each
//! function.
//!
//! Parameters of statements are `?1`, `?2`, …; most rows hold JSON documents.

use std::{
    fs,
    io::ErrorKind,
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
    thread,
    time::{Duration, Instant},
};

use rusqlite::{Connection, ErrorCode, Params, Row, TransactionBehavior, types::Type};
use serde::de::DeserializeOwned;
use volcomp_fleet::MachineId;

use crate::Error;

pub(crate) mod audit;
pub(crate) mod history;
pub(crate) mod machines;
pub(crate) mod models;
mod users;

pub use history::Retention;
pub use models::SignedValue;

/// Time after which a change counts as hanging: a commit waits only for the disk.
const HANG_TIMEOUT: Duration = Duration::from_secs(5);

pub struct Store {
    writer: Mutex<Connection>,
    reader: Mutex<Connection>,
    writing: Mutex<Option<Instant>>,
    /// When the database began to reject every change, and why.
    failing: Mutex<Option<(Instant, String)>>,
    /// If set, every use of the store panics.
    #[cfg(test)]
    is_faulty: std::sync::atomic::AtomicBool,
}

/// Guard that clears the start time of the current change when dropped.
struct Writes<'a>(&'a Mutex<Option<Instant>>);

impl Drop for Writes<'_> {
    fn drop(&mut self) {
        *lock(self.0) = None;
    }
}

impl Store {
    pub fn open(path: &Path) -> Result<Self, Error> {
        let mut writer = open(path)?;
        migrate(&mut writer)?;
        Ok(Self {
            writer: Mutex::new(writer),
            reader: Mutex::new(open(path)?),
            writing: Mutex::default(),
            failing: Mutex::default(),
            #[cfg(test)]
            is_faulty: false.into(),
        })
    }

    /// Makes every later use of the store panic.
    #[cfg(test)]
    pub(crate) fn inject_fault(&self) {
        self.is_faulty.store(true, std::sync::atomic::Ordering::Relaxed);
    }

    #[cfg(test)]
    fn check_fault(&self) {
        assert!(!self.is_faulty.load(std::sync::atomic::Ordering::Relaxed), "injected");
    }

    /// Limits the file to a number of pages, which simulates a full disk; for tests.
    #[doc(hidden)]
    pub fn limit_pages(&self, pages: u32) -> Result<(), Error> {
        Ok(lock(&self.writer).pragma_update(None, "max_page_count", pages)?)
    }

    pub(crate) fn read<T>(
        &self,
        work: impl FnOnce(&Connection) -> Result<T, Error>,
    ) -> Result<T, Error> {
        #[cfg(test)]
        self.check_fault();
        work(&lock(&self.reader))
    }

    /// Runs `work` in a write transaction, which is rolled back on an error or a panic.
    pub(crate) fn write<T>(
        &self,
        work: impl FnOnce(&Connection) -> Result<T, Error>,
    ) -> Result<T, Error> {
        #[cfg(test)]
        self.check_fault();
        let done = self.transaction(work);
        match &done {
            Ok(_) => *lock(&self.failing) = None,
            Err(Error::Sqlite(error)) => {
                lock(&self.failing).get_or_insert_with(|| (Instant::now(), error.to_string()));
            }
            // The program's own rules rejected the change, not the database.
            Err(_) => {}
        }
        done
    }

    fn transaction<T>(
        &self,
        work: impl FnOnce(&Connection) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let mut writer = lock(&self.writer);
        *lock(&self.writing) = Some(Instant::now());
        let _writes = Writes(&self.writing);
        // A deferred transaction that reads before it writes could fail, because another program may hold the lock by
        // then.
        let transaction = writer.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let done = work(&transaction)?;
        transaction.commit()?;
        Ok(done)
    }

    /// Why the database accepts no change at present, and for how long: the disk hangs, or the database rejects every
    /// change.
    pub fn trouble(&self) -> Option<(Duration, String)> {
        let since = *lock(&self.writing);
        let hang = since.map(|since| since.elapsed());
        if let Some(hang) = hang.filter(|hang| *hang > HANG_TIMEOUT) {
            let s = hang.as_secs();
            return Some((hang, format!("has not completed a change for {s} s: its disk hangs")));
        }
        let failing = lock(&self.failing).clone();
        failing.map(|(since, why)| (since.elapsed(), format!("rejects changes: {why}")))
    }
}

/// Locks a mutex and ignores poisoning: a panic leaves no transaction that could be committed.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Time to wait for a lock held by another program, such as the command line.
const LOCK_TIMEOUT: Duration = Duration::from_secs(30);
const RETRY_INTERVAL: Duration = Duration::from_millis(10);
const MAX_PREPARED: usize = 128;

pub(crate) fn execute(
    database: &Connection,
    sql: &str,
    values: impl Params,
) -> Result<usize, Error> {
    Ok(database.prepare_cached(sql)?.execute(values)?)
}

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

/// Opens the file, creating it if it does not exist. Only its owner may read it, because it holds password hashes and
/// models.
fn open(path: &Path) -> Result<Connection, Error> {
    let failed = |why: std::io::Error| Error::Database { file: path.display().to_string(), why };
    let mut options = fs::OpenOptions::new();
    // Create the file without opening an existing one. Closing an opened file would release the POSIX locks of this
    // program's connections to it, and another reading program would then delete the write-ahead log in use.
    match options.create_new(true).write(true).mode(0o600).open(path) {
        Err(why) if why.kind() != ErrorKind::AlreadyExists => return Err(failed(why)),
        _ => {}
    }
    if !fs::metadata(path).map_err(failed)?.is_file() {
        return Err(failed(std::io::Error::other("it is no regular file")));
    }
    let connection = Connection::open(path)?;
    connection.busy_timeout(LOCK_TIMEOUT)?;
    connection.set_prepared_statement_cache_capacity(MAX_PREPARED);
    begin_log(&connection)?;
    // Restrict the permissions only after SQLite has accepted the file as a database, so that other files keep theirs.
    make_private(path).map_err(failed)?;
    // Acknowledged messages must survive a power failure: every commit is on disk when it returns.
    connection.execute_batch(
        "PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON; PRAGMA cache_size = -65536;",
    )?;
    Ok(connection)
}

fn make_private(path: &Path) -> std::io::Result<()> {
    for suffix in ["", "-wal", "-shm"] {
        let mut name = path.as_os_str().to_owned();
        name.push(suffix);
        let file = Path::new(&name);
        match file.metadata() {
            Ok(metadata) if metadata.permissions().mode() & 0o077 != 0 => {
                fs::set_permissions(file, fs::Permissions::from_mode(0o600))?;
                tracing::warn!(
                    "{}: other users could read it: mode changed to 600",
                    file.display()
                );
            }
            _ => {}
        }
    }
    Ok(())
}

/// Switches to write-ahead logging. If several programs open a new file at once, SQLite immediately returns "busy" to
/// all but one, so this function retries.
fn begin_log(connection: &Connection) -> Result<(), Error> {
    let until = Instant::now() + LOCK_TIMEOUT;
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

/// Steps of the schema, each a list of statements. The database stores the number of applied steps, so steps may only
/// be added at the end.
const STEPS: &[&[&str]] = &[FIRST, CLOSED_BY_MACHINE, WISHES, UNIQUE_RECORDS];

const FIRST: &[&str] = &[
    "CREATE TABLE machines (machine TEXT PRIMARY KEY, site TEXT NOT NULL, document TEXT NOT NULL)",
    // Texts of machine files, each stored once.
    "CREATE TABLE models (sha256 TEXT PRIMARY KEY, document TEXT NOT NULL, text TEXT NOT NULL)",
    // Issued versions and their outcomes.
    "CREATE TABLE versions (machine TEXT NOT NULL, version BIGINT NOT NULL, model TEXT NOT NULL, rollout BIGINT,
        value_sha256 TEXT NOT NULL, document TEXT NOT NULL, PRIMARY KEY (machine, version))",
    // Newest signed value of each machine, as put under its key.
    "CREATE TABLE desired (machine TEXT PRIMARY KEY, version BIGINT NOT NULL, model TEXT NOT NULL, value TEXT NOT NULL)",
    "CREATE TABLE rollouts (id BIGINT PRIMARY KEY, state TEXT NOT NULL, wish TEXT, finished BIGINT NOT NULL)",
    "CREATE TABLE acknowledgements (machine TEXT NOT NULL, at_s DOUBLE PRECISION NOT NULL, version BIGINT NOT NULL,
        document TEXT NOT NULL)",
    "CREATE INDEX acknowledgements_of ON acknowledgements (machine, at_s)",
    // Audit records of machines, kept indefinitely.
    "CREATE TABLE records (machine TEXT NOT NULL, at_s DOUBLE PRECISION NOT NULL, document TEXT NOT NULL)",
    "CREATE INDEX records_of ON records (machine, at_s)",
    // Gateway instances, with the intervals of their stored messages.
    "CREATE TABLE instances (machine TEXT NOT NULL, instance TEXT NOT NULL, first_s DOUBLE PRECISION NOT NULL,
        document TEXT NOT NULL, PRIMARY KEY (machine, instance))",
    // Last state of each machine.
    "CREATE TABLE live (machine TEXT PRIMARY KEY, document TEXT NOT NULL)",
    // Conditions as received, until their minute is closed; then `raw` holds one row for each machine and minute.
    "CREATE TABLE recent (machine TEXT NOT NULL, at_s DOUBLE PRECISION NOT NULL, document TEXT NOT NULL)",
    "CREATE INDEX recent_at ON recent (at_s)",
    "CREATE TABLE raw (machine TEXT NOT NULL, minute BIGINT NOT NULL, document TEXT NOT NULL,
        PRIMARY KEY (machine, minute))",
    "CREATE TABLE minutes (machine TEXT NOT NULL, minute BIGINT NOT NULL, document TEXT NOT NULL,
        PRIMARY KEY (machine, minute))",
    "CREATE TABLE hours (machine TEXT NOT NULL, hour BIGINT NOT NULL, document TEXT NOT NULL,
        PRIMARY KEY (machine, hour))",
    // `hourly` marks the first telemetry message of an hour, which is kept longer.
    "CREATE TABLE telemetry (machine TEXT NOT NULL, at_s DOUBLE PRECISION NOT NULL, hourly BIGINT NOT NULL,
        document TEXT NOT NULL)",
    "CREATE INDEX telemetry_of ON telemetry (machine, at_s)",
    "CREATE TABLE alarms (id BIGINT PRIMARY KEY, machine TEXT, kind TEXT NOT NULL, text TEXT NOT NULL,
        since_s DOUBLE PRECISION NOT NULL, until_s DOUBLE PRECISION, seen_by TEXT)",
    "CREATE INDEX alarms_open ON alarms (until_s, machine)",
    "CREATE TABLE audit (number BIGINT PRIMARY KEY, document TEXT NOT NULL, hash TEXT NOT NULL)",
    // Users.
    "CREATE TABLE users (name TEXT PRIMARY KEY, role TEXT NOT NULL, password TEXT NOT NULL, disabled BIGINT NOT NULL,
        document TEXT NOT NULL)",
    "CREATE TABLE sessions (token_sha256 TEXT PRIMARY KEY, name TEXT NOT NULL, since_s DOUBLE PRECISION NOT NULL,
        until_s DOUBLE PRECISION NOT NULL, document TEXT NOT NULL)",
];

/// Minutes are closed machine by machine, which needs an index by machine.
const CLOSED_BY_MACHINE: &[&str] =
    &["DROP INDEX recent_at", "CREATE INDEX recent_of ON recent (machine, at_s)"];

/// Requests for a roll-out are queued, so that none replaces another. Later programs do not use the column `wish`.
const WISHES: &[&str] = &[
    "CREATE TABLE wishes (rollout BIGINT NOT NULL, number BIGINT NOT NULL, document TEXT NOT NULL,
        PRIMARY KEY (rollout, number))",
    "INSERT INTO wishes (rollout, number, document) SELECT id, 1, wish FROM rollouts WHERE wish IS NOT NULL",
    "UPDATE rollouts SET wish = NULL",
];

/// Redelivered records are recognized by their checksum. Records from before this step have NULL, and NULLs are distinct in a unique index.
const UNIQUE_RECORDS: &[&str] = &[
    "ALTER TABLE records ADD COLUMN record TEXT",
    "CREATE UNIQUE INDEX records_once ON records (machine, record)",
];

fn migrate(database: &mut Connection) -> Result<(), Error> {
    let database = database.transaction_with_behavior(TransactionBehavior::Immediate)?;
    database.execute_batch("CREATE TABLE IF NOT EXISTS schema (steps BIGINT NOT NULL)")?;
    let found = number(&database, "SELECT steps FROM schema", [])?;
    let known = STEPS.len() as u64;
    if found > known {
        return Err(Error::Newer { found, known });
    }
    for statements in STEPS.iter().skip(usize::try_from(found).unwrap_or(usize::MAX)) {
        database.execute_batch(&statements.join(";"))?;
    }
    execute(&database, "DELETE FROM schema", [])?;
    execute(&database, "INSERT INTO schema (steps) VALUES (?1)", [known])?;
    Ok(database.commit()?)
}
