//! Database schema. Booleans are 0 and 1, documents are JSON text.

use rusqlite::{Connection, TransactionBehavior};

use super::database::{execute, number};
use crate::Error;

/// Each step is a list of statements; the database stores the number of applied steps. Steps may only be added.
const STEPS: &[&[&str]] = &[FIRST, BY_MACHINE, WISHES, RECORDS_ONCE];

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
    // Conditions as received until their minute is closed; then in `raw`, one row for each machine and minute.
    "CREATE TABLE recent (machine TEXT NOT NULL, at_s DOUBLE PRECISION NOT NULL, document TEXT NOT NULL)",
    "CREATE INDEX recent_at ON recent (at_s)",
    "CREATE TABLE raw (machine TEXT NOT NULL, minute BIGINT NOT NULL, document TEXT NOT NULL,
        PRIMARY KEY (machine, minute))",
    "CREATE TABLE minutes (machine TEXT NOT NULL, minute BIGINT NOT NULL, document TEXT NOT NULL,
        PRIMARY KEY (machine, minute))",
    "CREATE TABLE hours (machine TEXT NOT NULL, hour BIGINT NOT NULL, document TEXT NOT NULL,
        PRIMARY KEY (machine, hour))",
    // `hourly`: the first of its hour, which is kept longer.
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

/// Minutes are closed machine by machine.
const BY_MACHINE: &[&str] = &[
    "DROP INDEX recent_at",
    "CREATE INDEX recent_of ON recent (machine, at_s)",
];

/// Requests for a roll-out are queued, so that none replaces another. The column `wish` is no longer used.
const WISHES: &[&str] = &[
    "CREATE TABLE wishes (rollout BIGINT NOT NULL, number BIGINT NOT NULL, document TEXT NOT NULL,
        PRIMARY KEY (rollout, number))",
    "INSERT INTO wishes (rollout, number, document) SELECT id, 1, wish FROM rollouts WHERE wish IS NOT NULL",
    "UPDATE rollouts SET wish = NULL",
];

/// Redelivered records are recognized by their checksum. Records from before this step have NULL, and NULLs are distinct in a unique index.
const RECORDS_ONCE: &[&str] = &[
    "ALTER TABLE records ADD COLUMN record TEXT",
    "CREATE UNIQUE INDEX records_once ON records (machine, record)",
];

/// Migrates a database to the newest schema in one transaction.
pub(super) fn bring_up(database: &mut Connection) -> Result<(), Error> {
    let database = database.transaction_with_behavior(TransactionBehavior::Immediate)?;
    database.execute_batch("CREATE TABLE IF NOT EXISTS schema (steps BIGINT NOT NULL)")?;
    let found = number(&database, "SELECT steps FROM schema", [])?;
    let known = STEPS.len() as u64;
    if found > known {
        return Err(Error::Newer { found, known });
    }
    for statements in STEPS
        .iter()
        .skip(usize::try_from(found).unwrap_or(usize::MAX))
    {
        database.execute_batch(&statements.join(";"))?;
    }
    execute(&database, "DELETE FROM schema", [])?;
    execute(&database, "INSERT INTO schema (steps) VALUES (?1)", [known])?;
    Ok(database.commit()?)
}
