//! The store: everything that the centre remembers, in a SQLite file.
//!
//! State: two connections to the database, one that writes and one that reads. Every function waits for the disk, so an
//! asynchronous program calls them on a thread that may wait. Several programs may have one database open.
//!
//! Every function fails where the file cannot be read or a row holds what this program does not write, or where it takes no change
//! (its disk is full, another program holds it); then nothing of it is changed. What else can fail is documented at the function.

pub(crate) mod alarms;
pub(crate) mod audit;
mod database;
pub(crate) mod history;
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

use rusqlite::{Connection, TransactionBehavior};

use crate::Error;
pub use history::Keep;
pub use models::Issued;

/// A change that takes longer is held up: a commit waits for nothing but the disk.
const HANGS_AFTER: Duration = Duration::from_secs(5);

/// Everything that the centre remembers.
pub struct Store {
    writer: Mutex<Connection>,
    reader: Mutex<Connection>,
    /// Since when a change is being written.
    writing: Mutex<Option<Instant>>,
    /// Every use is a fault of the program.
    #[cfg(test)]
    is_faulty: std::sync::atomic::AtomicBool,
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
    pub fn open(path: &Path) -> Result<Self, Error> {
        let mut writer = database::open(path)?;
        schema::bring_up(&mut writer)?;
        Ok(Self {
            writer: Mutex::new(writer),
            reader: Mutex::new(database::open(path)?),
            writing: Mutex::default(),
            #[cfg(test)]
            is_faulty: false.into(),
        })
    }

    /// Makes every use a fault of the program from now on.
    #[cfg(test)]
    pub(crate) fn break_down(&self) {
        self.is_faulty
            .store(true, std::sync::atomic::Ordering::Relaxed);
    }

    #[cfg(test)]
    fn check_fault(&self) {
        assert!(
            !self.is_faulty.load(std::sync::atomic::Ordering::Relaxed),
            "injected"
        );
    }

    /// Lets the file grow to so many pages and no further, as a full disk does: for tests.
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

    /// Writes, all of it or nothing: what fails, or ends its thread, is rolled back.
    pub(crate) fn write<T>(
        &self,
        work: impl FnOnce(&Connection) -> Result<T, Error>,
    ) -> Result<T, Error> {
        #[cfg(test)]
        self.check_fault();
        let mut writer = lock(&self.writer);
        *lock(&self.writing) = Some(Instant::now());
        let _writes = Writes(&self.writing);
        // Deferred transactions that read first and write then would find the file held by another.
        let transaction = writer.transaction_with_behavior(TransactionBehavior::Immediate)?;
        let done = work(&transaction)?;
        transaction.commit()?;
        Ok(done)
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
