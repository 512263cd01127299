//! The store: everything that the centre remembers, in SQLite or PostgreSQL, behind one interface.
//!
//! State: two connections to the database, one that writes and one that reads. Every function waits for the disk, so an
//! asynchronous program calls them on a thread that may wait. Several programs may have one database open.

pub(crate) mod alarms;
pub(crate) mod audit;
mod copy;
mod database;
pub(crate) mod desired;
mod history;
pub(crate) mod ingest;
mod live;
pub(crate) mod machines;
pub(crate) mod models;
#[cfg(feature = "postgres")]
mod postgres;
pub(crate) mod rollouts;
mod schema;
mod sqlite;
mod users;

use std::{
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

pub use copy::Copied;
pub use database::{Database, Row, Value};
pub use desired::Issued;
pub use history::Keep;
#[cfg(feature = "postgres")]
pub use postgres::PostgresPlace;
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
    /// The server of the database is not there, or not as it should be.
    #[error(
        "the database: {place}: {why}; expected a running server with this database and this user"
    )]
    NotReached {
        /// The server, the database and the user.
        place: String,
        /// What the client or the server of the database said.
        why: String,
    },
    /// PostgreSQL refuses, or its connection was lost; then nothing of a change is done.
    #[error("the database: {place}: {why}")]
    Postgres {
        /// The server, the database and the user.
        place: String,
        /// What the client or the server of the database said.
        why: String,
    },
    /// The connection was lost while a change was committed: it is done, or nothing of it.
    #[error("it is not known whether the change is stored, look before it is made again: {why}")]
    InDoubt {
        /// How the connection was lost.
        why: String,
    },
    /// The password of the database.
    #[error(transparent)]
    Password(#[from] volcomp_document::PrivateError),
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
    /// An older program has written the file, which is only read here.
    #[error(
        "{file}: its schema has {found} steps, expected {known}, those of this program: a file that is copied is read and not changed; any command of this program with this store, such as `machine list`, brings it up"
    )]
    Older {
        /// The file.
        file: String,
        /// The steps that it has.
        found: u64,
        /// The steps that this program knows.
        known: u64,
    },
    /// Another program has the file open.
    #[error(
        "{file}: another program has it open, expected none: the centre is ended first, so that what it stores is not left behind"
    )]
    InUse {
        /// The file.
        file: String,
    },
    /// What is copied into holds something.
    #[error(
        "the table {table} of the new database holds {rows} rows, expected an empty database: nothing was changed"
    )]
    NotEmpty {
        /// The table.
        table: String,
        /// How many rows it has.
        rows: u64,
    },
    /// What was read back is not what was written.
    #[error(
        "the table {table}: found {found} rows in the new database, or others, where the old one has {rows}; nothing was changed"
    )]
    Differs {
        /// The table.
        table: String,
        /// The rows of the old database.
        rows: u64,
        /// The rows that were read back.
        found: u64,
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
    writer: Mutex<Box<dyn Database>>,
    reader: Mutex<Box<dyn Database>>,
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
        Self::of(|| Ok(Box::new(sqlite::Sqlite::open(path)?)))
    }

    /// Opens a PostgreSQL database, and makes its tables where they are not there. Neither this nor anything else of the store
    /// may then be called from a thread that drives an asynchronous runtime.
    ///
    /// # Errors
    /// The database is not reached, or is of a newer program.
    #[cfg(feature = "postgres")]
    pub fn open_postgres(place: &PostgresPlace) -> Result<Self, StoreError> {
        Self::of(|| Ok(Box::new(postgres::Postgres::open(place)?)))
    }

    fn of(open: impl Fn() -> Result<Box<dyn Database>, StoreError>) -> Result<Self, StoreError> {
        let mut writer = open()?;
        schema::bring_up(writer.as_mut())?;
        Ok(Self {
            writer: Mutex::new(writer),
            reader: Mutex::new(open()?),
            writing: Mutex::default(),
        })
    }

    /// Lets a SQLite file grow to so many pages and no further, as a full disk does: for tests.
    ///
    /// # Errors
    /// It is no SQLite file, or the file cannot be read.
    #[doc(hidden)]
    pub fn limit_pages(&self, pages: u32) -> Result<(), StoreError> {
        let sql = format!("PRAGMA max_page_count = {pages}");
        lock(&self.writer).rows(&sql, &[]).map(|_| ())
    }

    /// Reads.
    pub(crate) fn read<T>(
        &self,
        work: impl FnOnce(&mut dyn Database) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        work(lock(&self.reader).as_mut())
    }

    /// Writes, all of it or nothing.
    pub(crate) fn write<T>(
        &self,
        work: impl FnOnce(&mut dyn Database) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        self.write_or(work)
    }

    /// The same for work that may fail in ways of its own.
    pub(crate) fn write_or<T, E: From<StoreError>>(
        &self,
        work: impl FnOnce(&mut dyn Database) -> Result<T, E>,
    ) -> Result<T, E> {
        let mut writer = lock(&self.writer);
        *lock(&self.writing) = Some(Instant::now());
        let _writes = Writes(&self.writing);
        database::transaction(writer.as_mut(), work)
    }

    /// For how long a change has been waiting for the database, where that is so long that its disk or its server hangs: nothing
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

#[cfg(test)]
pub(crate) use faulty::faulty;

/// A store in which the program has a fault, for tests.
#[cfg(test)]
mod faulty {
    use std::{
        path::Path,
        sync::{
            Arc,
            atomic::{AtomicBool, Ordering},
        },
    };

    use super::{Database, Row, Store, StoreError, Value, sqlite::Sqlite};

    struct Faulty(Sqlite, Arc<AtomicBool>);

    impl Faulty {
        fn inner(&mut self) -> &mut Sqlite {
            assert!(!self.1.load(Ordering::Relaxed), "injected");
            &mut self.0
        }
    }

    impl Database for Faulty {
        fn execute(&mut self, sql: &str, parameters: &[Value]) -> Result<u64, StoreError> {
            self.inner().execute(sql, parameters)
        }

        fn rows(&mut self, sql: &str, parameters: &[Value]) -> Result<Vec<Row>, StoreError> {
            self.inner().rows(sql, parameters)
        }

        fn each(
            &mut self,
            sql: &str,
            take: &mut dyn FnMut(Row) -> Result<(), StoreError>,
        ) -> Result<(), StoreError> {
            self.inner().each(sql, take)
        }
    }

    /// A store, and what makes every one of its statements a fault of the program.
    pub(crate) fn faulty(path: &Path) -> Result<(Store, Arc<AtomicBool>), StoreError> {
        let is_faulty = Arc::new(AtomicBool::new(false));
        let open = || -> Result<Box<dyn Database>, StoreError> {
            let sqlite = Sqlite::open(path)?;
            Ok(Box::new(Faulty(sqlite, Arc::clone(&is_faulty))))
        };
        Ok((Store::of(open)?, is_faulty))
    }
}
