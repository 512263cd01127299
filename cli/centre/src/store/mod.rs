//! The store: everything that the centre remembers, in a SQLite file.
//!
//! State: two connections to the database, one that writes and one that reads. Every function waits for the disk, so an
//! asynchronous program calls them on a thread that may wait. Several programs may have one database open.

pub(crate) mod alarms;
pub(crate) mod audit;
mod database;
pub(crate) mod desired;
mod history;
pub(crate) mod ingest;
mod live;
pub(crate) mod machines;
pub(crate) mod models;
pub(crate) mod rollouts;
mod schema;
mod users;

use std::{
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

pub use database::{Database, Row, Value};
pub use desired::Issued;
pub use history::Keep;
pub use users::Changed;

/// A change that takes longer is held up: a commit waits for nothing but the disk.
const HANGS_AFTER: Duration = Duration::from_secs(5);

/// Why the store does not do what it is asked.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// SQLite refuses.
    #[error("the database: {0}")]
    Sqlite(#[from] rusqlite::Error),
    /// The file of the database cannot be created, or kept from others.
    #[error(
        "the database: {file}: {why}; expected a file that this program can keep to its owner (mode 600)"
    )]
    Private {
        /// The path of the file.
        file: String,
        /// What the system reports.
        why: std::io::Error,
    },
    /// A document in the database is none of ours.
    #[error("a document in the database: {0}")]
    Document(#[from] serde_json::Error),
    /// A column holds something else.
    #[error("column {column} of an answer of the database: found {found}, expected {expected}")]
    Column {
        /// The place of the column, from 0.
        column: usize,
        /// What it holds.
        found: String,
        /// What it should hold.
        expected: &'static str,
    },
    /// A newer program has changed the database.
    #[error(
        "the database has {found} steps of its schema, this program knows {known}: expected a program as new as the one that wrote it"
    )]
    Newer {
        /// The steps that it has.
        found: u64,
        /// The steps that this program knows.
        known: u64,
    },
    /// A machine has its turn in a roll-out that is not over.
    #[error(
        "{machine} has its turn in roll-out {rollout}, which is not over: expected that one done or aborted first"
    )]
    Rollout {
        /// The machine.
        machine: String,
        /// The number of that roll-out.
        rollout: u64,
    },
    /// Nobody has to decide whether a machine keeps the model of a roll-out that goes on or is done.
    #[error(
        "roll-out {rollout} goes on or is done: expected one that has stopped or was ended before it was done"
    )]
    NotBrokenOff {
        /// The number of the roll-out.
        rollout: u64,
    },
    /// A machine cannot keep what it does not have.
    #[error(
        "{machine} does not have the model of roll-out {rollout} in force: expected a machine that corrects with it"
    )]
    NotInForce {
        /// The machine.
        machine: String,
        /// The number of the roll-out.
        rollout: u64,
    },
    /// A confirmation that would be sent to nobody.
    #[error("nothing is confirmed: {why}")]
    NotConfirmed {
        /// Why nothing would come of it, and what to do.
        why: String,
    },
    /// What is asked for is not there.
    #[error("found no {what} {name}")]
    Missing {
        /// The kind of thing.
        what: &'static str,
        /// Its name.
        name: String,
    },
}

/// Everything that the centre remembers.
pub struct Store {
    writer: Mutex<Database>,
    reader: Mutex<Database>,
    /// Since when a change is being written.
    writing: Mutex<Option<Instant>>,
}

/// A change is no longer being written when this is dropped.
struct Writes<'a>(&'a Mutex<Option<Instant>>);

impl Drop for Writes<'_> {
    fn drop(&mut self) {
        *lock(self.0) = None;
    }
}

impl Store {
    /// Opens a SQLite file, and makes it where it is not there.
    ///
    /// # Errors
    /// The file cannot be opened, or is of a newer program.
    pub fn open(path: &Path) -> Result<Self, StoreError> {
        let mut writer = Database::open(path)?;
        schema::bring_up(&mut writer)?;
        Ok(Self {
            writer: Mutex::new(writer),
            reader: Mutex::new(Database::open(path)?),
            writing: Mutex::default(),
        })
    }

    /// Makes every statement a fault of the program from now on.
    #[cfg(test)]
    pub(crate) fn break_down(&self) {
        for connection in [&self.writer, &self.reader] {
            lock(connection).is_faulty = true;
        }
    }

    /// Lets the file grow to so many pages and no further, as a full disk does: for tests.
    ///
    /// # Errors
    /// The file cannot be read.
    #[doc(hidden)]
    pub fn limit_pages(&self, pages: u32) -> Result<(), StoreError> {
        let sql = format!("PRAGMA max_page_count = {pages}");
        lock(&self.writer).rows(&sql, &[]).map(|_| ())
    }

    /// Reads.
    pub(crate) fn read<T>(
        &self,
        work: impl FnOnce(&mut Database) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        work(&mut lock(&self.reader))
    }

    /// Writes, all of it or nothing.
    pub(crate) fn write<T>(
        &self,
        work: impl FnOnce(&mut Database) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.write_or(work)
    }

    /// The same for work that may fail in ways of its own.
    pub(crate) fn write_or<T, E: From<StoreError>>(
        &self,
        work: impl FnOnce(&mut Database) -> Result<T, E>,
    ) -> Result<T, E> {
        let mut writer = lock(&self.writer);
        *lock(&self.writing) = Some(Instant::now());
        let _writes = Writes(&self.writing);
        database::transaction(&mut writer, work)
    }

    /// For how long a change has been waiting for the database, where that is so long that its disk hangs: nothing
    /// else is written meanwhile, not even an alarm.
    pub fn hangs_for(&self) -> Option<Duration> {
        let since = *lock(&self.writing);
        since
            .map(|since| since.elapsed())
            .filter(|for_long| *for_long > HANGS_AFTER)
    }
}

/// A thread that ended with the connection in its hands has left no transaction that could be committed.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
