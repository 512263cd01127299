//! The SQLite file: statements with parameters `?1`, `?2`, …, rows, transactions.

use std::{
    fs,
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::Path,
    thread,
    time::{Duration, Instant},
};

use rusqlite::{
    CachedStatement, Connection, ErrorCode,
    types::{ToSqlOutput, ValueRef},
};

use super::StoreError;

/// Another program (the command line) may hold the file so long.
const BUSY: Duration = Duration::from_secs(30);
/// What was busy is tried again after so long.
const AGAIN: Duration = Duration::from_millis(10);
/// Statements that are kept ready.
const READY: usize = 128;

/// A value of a parameter or of a column.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// Nothing.
    Null,
    /// A whole number (BIGINT).
    Int(i64),
    /// A number (DOUBLE PRECISION).
    Real(f64),
    /// A text (TEXT).
    Text(String),
}

macro_rules! from {
    ($from:ty, $value:ident => $to:expr) => {
        impl From<$from> for Value {
            fn from($value: $from) -> Self {
                $to
            }
        }
    };
}

from!(i64, value => Self::Int(value));
from!(u32, value => Self::Int(i64::from(value)));
// A number beyond i64 is none that this program makes: it is held at the end.
from!(u64, value => Self::Int(i64::try_from(value).unwrap_or(i64::MAX)));
from!(bool, value => Self::Int(i64::from(value)));
from!(f64, value => Self::Real(value));
from!(String, value => Self::Text(value));
from!(&str, value => Self::Text(value.to_owned()));
from!(&volcomp_fleet::MachineId, value => Self::Text(value.to_string()));

impl<T: Into<Self>> From<Option<T>> for Value {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::Null, Into::into)
    }
}

/// A row of an answer.
#[derive(Clone, Debug, PartialEq)]
pub struct Row(pub Vec<Value>);

impl Row {
    fn wrong(&self, column: usize, expected: &'static str) -> StoreError {
        StoreError::Column {
            column,
            found: format!("{:?}", self.0.get(column)),
            expected,
        }
    }

    /// A whole number that is not negative.
    ///
    /// # Errors
    /// The column is another thing.
    pub fn count(&self, column: usize) -> Result<u64, StoreError> {
        match self.0.get(column) {
            Some(Value::Int(value)) => {
                u64::try_from(*value).map_err(|_| self.wrong(column, "a count"))
            }
            _ => Err(self.wrong(column, "a count")),
        }
    }

    /// A number.
    ///
    /// # Errors
    /// The column is another thing.
    pub fn real(&self, column: usize) -> Result<f64, StoreError> {
        match self.0.get(column) {
            Some(Value::Real(value)) => Ok(*value),
            Some(Value::Int(value)) => Ok(*value as f64),
            _ => Err(self.wrong(column, "a number")),
        }
    }

    /// A text.
    ///
    /// # Errors
    /// The column is another thing.
    pub fn text(&self, column: usize) -> Result<&str, StoreError> {
        match self.0.get(column) {
            Some(Value::Text(value)) => Ok(value),
            _ => Err(self.wrong(column, "a text")),
        }
    }

    /// Whether there is nothing in the column.
    pub fn is_null(&self, column: usize) -> bool {
        matches!(self.0.get(column), None | Some(Value::Null))
    }

    /// A column that may hold nothing, read by one of the other functions.
    ///
    /// # Errors
    /// The column is another thing.
    pub fn optional<'a, T>(
        &'a self,
        column: usize,
        read: impl FnOnce(&'a Self, usize) -> Result<T, StoreError>,
    ) -> Result<Option<T>, StoreError> {
        if self.is_null(column) {
            Ok(None)
        } else {
            read(self, column).map(Some)
        }
    }

    /// A document: JSON in a text.
    ///
    /// # Errors
    /// The column is another thing, or another document.
    pub fn json<T: serde::de::DeserializeOwned>(&self, column: usize) -> Result<T, StoreError> {
        Ok(serde_json::from_str(self.text(column)?)?)
    }

    /// A document of another program that is kept as it came. JSON that is none for this program (a number beyond the range, half a
    /// character) is told as a text, with the reason.
    ///
    /// # Errors
    /// The column is another thing.
    pub fn json_or_text(&self, column: usize) -> Result<serde_json::Value, StoreError> {
        let text = self.text(column)?;
        Ok(serde_json::from_str(text).unwrap_or_else(|error| {
            let shown: String = text.chars().take(1000).collect();
            serde_json::json!({ "unreadable": shown, "why": error.to_string() })
        }))
    }
}

/// A connection to the file.
pub struct Database {
    connection: Connection,
    /// Every statement is a fault of the program.
    #[cfg(test)]
    pub(super) is_faulty: bool,
}

impl Database {
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
        Ok(Self {
            connection,
            #[cfg(test)]
            is_faulty: false,
        })
    }

    /// Executes a statement, and returns how many rows it changed.
    ///
    /// # Errors
    /// The statement is invalid, or the database takes no change: its disk is full, another program holds it.
    pub fn execute(&mut self, sql: &str, parameters: &[Value]) -> Result<u64, StoreError> {
        let mut statement = self.prepared(sql)?;
        Ok(statement.execute(rusqlite::params_from_iter(parameters))? as u64)
    }

    /// The rows of a query.
    ///
    /// # Errors
    /// The query is invalid, or the file cannot be read.
    pub fn rows(&mut self, sql: &str, parameters: &[Value]) -> Result<Vec<Row>, StoreError> {
        let mut statement = self.prepared(sql)?;
        let columns = statement.column_count();
        let mut rows = statement.query(rusqlite::params_from_iter(parameters))?;
        let mut found = Vec::new();
        while let Some(row) = rows.next()? {
            found.push(row_of(row, columns)?);
        }
        Ok(found)
    }

    /// The first row of a query.
    ///
    /// # Errors
    /// As for [`Database::rows`].
    pub fn first(&mut self, sql: &str, parameters: &[Value]) -> Result<Option<Row>, StoreError> {
        Ok(self.rows(sql, parameters)?.into_iter().next())
    }

    fn prepared(&self, sql: &str) -> rusqlite::Result<CachedStatement<'_>> {
        #[cfg(test)]
        assert!(!self.is_faulty, "injected");
        self.connection.prepare_cached(sql)
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

/// Does several things as one: all of them, or nothing.
pub(super) fn transaction<T, E: From<StoreError>>(
    database: &mut Database,
    work: impl FnOnce(&mut Database) -> Result<T, E>,
) -> Result<T, E> {
    // Deferred transactions that read first and write then would find the file held by another.
    database.execute("BEGIN IMMEDIATE", &[])?;
    let mut open = Open {
        database,
        is_done: false,
    };
    let done = work(&mut *open.database).and_then(|done| {
        open.database.execute("COMMIT", &[])?;
        Ok(done)
    });
    open.is_done = done.is_ok();
    done
}

/// A transaction that is rolled back where it does not come to its end: its work fails, or ends its thread.
struct Open<'a> {
    database: &'a mut Database,
    is_done: bool,
}

impl Drop for Open<'_> {
    fn drop(&mut self) {
        if !self.is_done {
            // It may be gone already: the first reason is the one to be told.
            let _ = self.database.execute("ROLLBACK", &[]);
        }
    }
}
