//! SQLite: one file beside the centre.

use std::{
    fs,
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::Path,
    thread,
    time::{Duration, Instant},
};

use rusqlite::{
    Connection, ErrorCode, OpenFlags,
    types::{ToSqlOutput, ValueRef},
};

use super::{
    StoreError,
    database::{Database, Row, Value},
};

/// Another program (the command line) may hold the file so long.
const BUSY: Duration = Duration::from_secs(30);
/// The same where it must not be held by another at all.
const BUSY_ALONE: Duration = Duration::from_secs(2);
/// What was busy is tried again after so long.
const AGAIN: Duration = Duration::from_millis(10);
/// Statements that are kept ready.
const READY: usize = 128;

/// A connection to a file.
pub(crate) struct Sqlite(Connection);

impl Sqlite {
    /// Opens the file, and makes it where it is not there. Only its owner may read it: it holds password hashes and models.
    pub(crate) fn open(path: &Path) -> Result<Self, StoreError> {
        make_private(path)?;
        let connection = Connection::open(path)?;
        connection.busy_timeout(BUSY)?;
        connection.set_prepared_statement_cache_capacity(READY);
        begin_log(&connection)?;
        // What was acknowledged to the server must outlive a power failure: every commit is on disk when it returns.
        connection.execute_batch(
            "PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON; PRAGMA cache_size = -65536;",
        )?;
        Ok(Self(connection))
    }

    /// Opens a file that is there, and changes nothing in it.
    pub(crate) fn open_to_read(path: &Path) -> Result<Self, StoreError> {
        if !path.is_file() {
            return Err(StoreError::Missing {
                what: "file of a store:",
                name: path.display().to_string(),
            });
        }
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags)?;
        connection.busy_timeout(BUSY_ALONE)?;
        Ok(Self(connection))
    }

    /// Checks that no other program has the file open. What stands in the log beside it is in the file then.
    pub(crate) fn check_alone(path: &Path) -> Result<(), StoreError> {
        let file = path.display().to_string();
        let connection = Connection::open(path)?;
        connection.busy_timeout(BUSY_ALONE)?;
        // The log beside the file can be given up only where nobody else has the file open, idle as he may be.
        let given_up = connection.query_row("PRAGMA journal_mode = DELETE", [], |row| {
            row.get::<_, String>(0)
        });
        match given_up {
            Ok(mode) if mode == "delete" => Ok(()),
            Err(error) if error.sqlite_error_code() != Some(ErrorCode::DatabaseBusy) => {
                Err(error.into())
            }
            _ => Err(StoreError::InUse { file }),
        }
    }
}

/// Creates the file with mode 600, or takes the rights of others away from an existing one. SQLite gives the files beside
/// it the same mode when it creates them.
fn make_private(path: &Path) -> Result<(), StoreError> {
    let failed = |why: std::io::Error| StoreError::Private {
        file: path.display().to_string(),
        why,
    };
    let mut options = fs::OpenOptions::new();
    options
        .create(true)
        .truncate(false)
        .write(true)
        .mode(0o600)
        .open(path)
        .map_err(failed)?;
    for suffix in ["", "-wal", "-shm"] {
        let mut name = path.as_os_str().to_owned();
        name.push(suffix);
        let file = Path::new(&name);
        match file.metadata() {
            Ok(metadata) if metadata.permissions().mode() & 0o077 != 0 => {
                fs::set_permissions(file, fs::Permissions::from_mode(0o600)).map_err(failed)?;
                tracing::warn!("{}: others could read it: mode is now 600", file.display());
            }
            _ => {}
        }
    }
    Ok(())
}

/// Has changes go to a log beside the file. Where several programs begin with a new file at one time, SQLite tells all but one of
/// them that it is busy without waiting: they try again.
fn begin_log(connection: &Connection) -> Result<(), StoreError> {
    let until = Instant::now() + BUSY;
    loop {
        match connection.execute_batch("PRAGMA journal_mode = WAL") {
            Err(error)
                if error.sqlite_error_code() == Some(ErrorCode::DatabaseBusy)
                    && Instant::now() < until =>
            {
                thread::sleep(AGAIN);
            }
            done => return Ok(done?),
        }
    }
}

/// A row as this program has it.
fn row_of(row: &rusqlite::Row<'_>, columns: usize) -> Result<Row, StoreError> {
    let values: Result<Vec<Value>, StoreError> = (0..columns)
        .map(|column| {
            Ok(match row.get_ref(column)? {
                ValueRef::Null => Value::Null,
                ValueRef::Integer(value) => Value::Int(value),
                ValueRef::Real(value) => Value::Real(value),
                ValueRef::Text(value) | ValueRef::Blob(value) => {
                    Value::Text(String::from_utf8_lossy(value).into_owned())
                }
            })
        })
        .collect();
    Ok(Row(values?))
}

impl rusqlite::ToSql for Value {
    fn to_sql(&self) -> rusqlite::Result<ToSqlOutput<'_>> {
        Ok(ToSqlOutput::Borrowed(match self {
            Self::Null => ValueRef::Null,
            Self::Int(value) => ValueRef::Integer(*value),
            Self::Real(value) => ValueRef::Real(*value),
            Self::Text(value) => ValueRef::Text(value.as_bytes()),
        }))
    }
}

impl Database for Sqlite {
    fn execute(&mut self, sql: &str, parameters: &[Value]) -> Result<u64, StoreError> {
        // Deferred transactions that read first and write then would find the file held by another.
        let sql = if sql == "BEGIN" {
            "BEGIN IMMEDIATE"
        } else {
            sql
        };
        let mut statement = self.0.prepare_cached(sql)?;
        Ok(statement.execute(rusqlite::params_from_iter(parameters))? as u64)
    }

    fn rows(&mut self, sql: &str, parameters: &[Value]) -> Result<Vec<Row>, StoreError> {
        let mut statement = self.0.prepare_cached(sql)?;
        let columns = statement.column_count();
        let mut rows = statement.query(rusqlite::params_from_iter(parameters))?;
        let mut found = Vec::new();
        while let Some(row) = rows.next()? {
            found.push(row_of(row, columns)?);
        }
        Ok(found)
    }

    fn each(
        &mut self,
        sql: &str,
        take: &mut dyn FnMut(Row) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        let mut statement = self.0.prepare(sql)?;
        let columns = statement.column_count();
        let mut rows = statement.query([])?;
        while let Some(row) = rows.next()? {
            take(row_of(row, columns)?)?;
        }
        Ok(())
    }
}
