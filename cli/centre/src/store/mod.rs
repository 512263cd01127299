//! The store: persistent data of the centre in a SQLite file.
//!
//! State: two connections to the database, one for writing and one for reading. Every function blocks on the disk, so
//! asynchronous programs call it on a blocking thread. Several programs may open the same database.
//!
//! Every function fails, without changing anything, if the file cannot be read, a row holds data that this program does
//! not write, or a change is rejected (full disk, locked by another program). Other errors are documented at each
//! function.

pub(crate) mod alarms;
pub(crate) mod audit;
mod database;
pub(crate) mod history;
pub(crate) mod machines;
pub(crate) mod models;
pub(crate) mod rollouts;
mod users;

use std::{
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use rusqlite::{Connection, TransactionBehavior};

use crate::Error;
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
        let mut writer = database::open(path)?;
        database::migrate(&mut writer)?;
        Ok(Self {
            writer: Mutex::new(writer),
            reader: Mutex::new(database::open(path)?),
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
