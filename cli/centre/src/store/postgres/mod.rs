//! PostgreSQL: a server that a company has anyway, with its own copies and its own disks.
//!
//! State: a connection that is made anew when it was lost, but never within a transaction, which is lost with it. Not to be
//! used from a thread that drives an asynchronous runtime: it waits for its own.

mod link;
mod place;
mod values;

use tokio::runtime::Runtime;

pub use self::place::PostgresPlace;

use self::link::{Failed, Link};
use super::{
    StoreError,
    database::{Database, Row, Value},
};

/// What a transaction begins with. One program writes at a time, as with SQLite, since numbers are drawn from what is there;
/// each of its statements sees what was committed before it.
const BEGIN: &str = "BEGIN ISOLATION LEVEL READ COMMITTED READ WRITE; SELECT pg_advisory_xact_lock(7240114893225402369)";
/// So many statements wait at the most before they are sent.
const QUEUE: usize = 512;

/// A database on a server.
pub(crate) struct Postgres {
    place: PostgresPlace,
    /// `Some` until it is dropped.
    runtime: Option<Runtime>,
    link: Option<Link>,
    transaction: Transaction,
    queue: Vec<(String, Vec<Value>)>,
}

/// Where a transaction stands.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Transaction {
    /// There is none.
    None,
    /// It goes on.
    Open,
    /// A statement of it has failed: it ends with nothing done.
    Failed,
}

impl Postgres {
    /// Connects.
    pub(crate) fn open(place: &PostgresPlace) -> Result<Self, StoreError> {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()
            .map_err(|error| StoreError::NotReached {
                place: place.to_string(),
                why: error.to_string(),
            })?;
        let link = Link::open(&runtime, place)?;
        Ok(Self {
            place: place.clone(),
            runtime: Some(runtime),
            link: Some(link),
            transaction: Transaction::None,
            queue: Vec::new(),
        })
    }

    /// Does something over the connection, which is made anew where it was lost before, outside of a transaction.
    fn with<T>(
        &mut self,
        work: impl FnOnce(&mut Link, &Runtime) -> Result<T, Failed>,
    ) -> Result<T, StoreError> {
        let Some(runtime) = &self.runtime else {
            return Err(self.failed(&"it was closed"));
        };
        let link = match &mut self.link {
            Some(link) => link,
            None if self.transaction == Transaction::None => {
                self.link.insert(Link::open(runtime, &self.place)?)
            }
            None => return Err(self.failed(&"the connection was lost in the middle of a change")),
        };
        let done = work(link, runtime);
        if done.is_err() && self.transaction == Transaction::Open {
            self.transaction = Transaction::Failed;
        }
        if done.as_ref().is_err_and(Failed::is_lost) {
            self.link = None;
        }
        done.map_err(|error| self.failed(&error))
    }

    /// The same for what may be done twice: a connection that is found lost, as after a restart of the server, is made anew
    /// at once.
    fn with_anew<T>(
        &mut self,
        mut work: impl FnMut(&mut Link, &Runtime) -> Result<T, Failed>,
    ) -> Result<T, StoreError> {
        let had_one = self.link.is_some() && self.transaction == Transaction::None;
        match self.with(&mut work) {
            Err(_) if had_one && self.link.is_none() => self.with(work),
            done => done,
        }
    }

    fn failed(&self, why: &dyn std::fmt::Display) -> StoreError {
        StoreError::Postgres {
            place: self.place.to_string(),
            why: why.to_string(),
        }
    }

    /// Sends what waits.
    fn flush(&mut self) -> Result<(), StoreError> {
        if self.queue.is_empty() {
            return Ok(());
        }
        let queue = std::mem::take(&mut self.queue);
        self.with(|link, runtime| link.execute_all(runtime, &queue))
    }

    fn begin(&mut self) -> Result<(), StoreError> {
        if self.transaction != Transaction::None {
            // Whoever began it has ended before its end.
            self.roll_back();
        }
        let begun = self.with_anew(|link, runtime| link.batch(runtime, BEGIN));
        match begun {
            Ok(()) => self.transaction = Transaction::Open,
            // The lock was not got: what was begun ends.
            Err(_) => self.roll_back(),
        }
        begun
    }

    fn commit(&mut self) -> Result<(), StoreError> {
        let sent = self.flush();
        if self.transaction != Transaction::Open {
            // The server would say yes, and have done nothing.
            return Err(match sent {
                Err(error) => error,
                Ok(()) => self.failed(&"a statement of the change has failed"),
            });
        }
        let done = self.with(|link, runtime| link.batch(runtime, "COMMIT"));
        if done.is_err() && self.link.is_none() {
            // It may be done: whether it is, the database tells when it is back.
            return done.map_err(|error| StoreError::InDoubt {
                why: error.to_string(),
            });
        }
        if done.is_ok() {
            self.transaction = Transaction::None;
        }
        done
    }

    fn roll_back(&mut self) {
        self.queue.clear();
        if let (Some(link), Some(runtime)) = (&self.link, &self.runtime)
            && link.batch(runtime, "ROLLBACK").is_err()
        {
            // The server ends the transaction with the connection.
            self.link = None;
        }
        self.transaction = Transaction::None;
    }
}

impl Drop for Postgres {
    /// It may be the last thing that a thread of an asynchronous runtime does, which must not wait for another.
    fn drop(&mut self) {
        self.link = None;
        if let Some(runtime) = self.runtime.take() {
            runtime.shutdown_background();
        }
    }
}

impl Database for Postgres {
    fn execute(&mut self, sql: &str, parameters: &[Value]) -> Result<u64, StoreError> {
        match sql {
            "BEGIN" => self.begin().map(|()| 0),
            "COMMIT" => self.commit().map(|()| 0),
            "ROLLBACK" => {
                self.roll_back();
                Ok(0)
            }
            _ => {
                self.flush()?;
                self.with(|link, runtime| link.execute(runtime, sql, parameters))
            }
        }
    }

    fn execute_later(&mut self, sql: &str, parameters: Vec<Value>) -> Result<(), StoreError> {
        self.queue.push((sql.to_owned(), parameters));
        if self.queue.len() >= QUEUE || self.transaction != Transaction::Open {
            self.flush()?;
        }
        Ok(())
    }

    fn rows(&mut self, sql: &str, parameters: &[Value]) -> Result<Vec<Row>, StoreError> {
        self.flush()?;
        let rows = self.with_anew(|link, runtime| link.rows(runtime, sql, parameters))?;
        let rows: Result<Vec<Row>, tokio_postgres::Error> = rows.iter().map(values::row).collect();
        rows.map_err(|error| self.failed(&error))
    }

    fn each(
        &mut self,
        sql: &str,
        take: &mut dyn FnMut(Row) -> Result<(), StoreError>,
    ) -> Result<(), StoreError> {
        self.flush()?;
        self.with(|link, runtime| link.declare(runtime, sql))?;
        loop {
            let rows = self.with(|link, runtime| link.fetch(runtime))?;
            if rows.is_empty() {
                break;
            }
            for row in &rows {
                take(values::row(row).map_err(|error| self.failed(&error))?)?;
            }
        }
        self.with(|link, runtime| link.batch(runtime, link::CLOSE))
    }
}
