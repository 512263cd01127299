//! What the store needs of a database: statements with parameters, rows, transactions.
//!
//! Every statement is written once, in the SQL that SQLite and PostgreSQL have in common, with parameters `?1`, `?2`, … .

use super::StoreError;

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

/// A connection to a database.
pub trait Database: Send {
    /// Executes a statement, and tells how many rows it changed.
    ///
    /// # Errors
    /// The statement is none, or the database takes no change: its disk is full, another program holds it, its server is gone.
    fn execute(&mut self, sql: &str, parameters: &[Value]) -> Result<u64, StoreError>;

    /// Executes a statement in a transaction, of which nobody asks how many rows it changes. A database that is far away may
    /// wait with it until the next statement that is answered; `COMMIT` is one.
    ///
    /// # Errors
    /// As for `execute`: of this one, or of one that waited.
    fn execute_later(&mut self, sql: &str, parameters: Vec<Value>) -> Result<(), StoreError> {
        self.execute(sql, &parameters).map(drop)
    }

    /// The rows of a question.
    ///
    /// # Errors
    /// The question is none, or the database cannot be read: its file or its server is gone.
    fn rows(&mut self, sql: &str, parameters: &[Value]) -> Result<Vec<Row>, StoreError>;

    /// Gives each row of a question without parameters to `take`, as they come, so that a large table need not have room in memory.
    /// Only in a transaction.
    ///
    /// # Errors
    /// As for `rows`, and what `take` fails with.
    fn each(
        &mut self,
        sql: &str,
        take: &mut dyn FnMut(Row) -> Result<(), StoreError>,
    ) -> Result<(), StoreError>;
}

impl dyn Database + '_ {
    /// The first row of a question.
    ///
    /// # Errors
    /// The question is none, or the database cannot be read: its file or its server is gone.
    pub fn first(&mut self, sql: &str, parameters: &[Value]) -> Result<Option<Row>, StoreError> {
        Ok(self.rows(sql, parameters)?.into_iter().next())
    }
}

/// Does several things as one: all of them, or nothing.
pub(super) fn transaction<T, E: From<StoreError>>(
    database: &mut dyn Database,
    work: impl FnOnce(&mut dyn Database) -> Result<T, E>,
) -> Result<T, E> {
    database.execute("BEGIN", &[])?;
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
    database: &'a mut dyn Database,
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
