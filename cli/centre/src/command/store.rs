//! The store, carried over.

use std::fmt::Write;

use super::{CommandError, open, print};
use crate::config::{Config, StorePlace};

pub(super) fn copy(from: &Config, to: &Config, by: &str) -> Result<(), CommandError> {
    #[cfg_attr(
        not(feature = "postgres"),
        expect(
            clippy::infallible_destructuring_match,
            reason = "there are two kinds with the feature `postgres`"
        )
    )]
    let file = match &from.store {
        StorePlace::File(file) => file,
        #[cfg(feature = "postgres")]
        StorePlace::Postgres(place) => {
            return Err(CommandError::Wrong(format!(
                "[store] of --config: found {place}, expected a SQLite file; a PostgreSQL database is copied with its own pg_dump"
            )));
        }
    };
    if from.store == to.store {
        return Err(CommandError::Wrong(format!(
            "[store] of --to: found {} as in --config, expected another database",
            to.store
        )));
    }
    let copied = open(to)?.copy_from(file, by)?;
    let mut said = String::new();
    for table in &copied {
        let _ = writeln!(
            said,
            "{:<17} {:>10} rows  {}",
            table.table, table.rows, table.checksum
        );
    }
    let _ = writeln!(
        said,
        "everything has arrived in {}\nstart the centre with the configuration of --to from now on; {} is as it was and no longer used",
        to.store,
        file.display()
    );
    print(&said)
}
