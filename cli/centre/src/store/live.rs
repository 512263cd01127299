//! What machines run and shall run now, for all of them at once.

use std::collections::HashMap;

use volcomp_fleet::MachineId;

use super::{Store, StoreError, ingest, models::machine};
use crate::records::Live;

impl Store {
    /// What every machine shall run: the newest version and the checksum of its model, without the signed values, which are
    /// large.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn wanted(&self) -> Result<HashMap<MachineId, (u64, String)>, StoreError> {
        self.read(|database| {
            let rows = database.rows(
                "SELECT machine, version, model FROM desired WHERE value <> ''",
                &[],
            )?;
            rows.iter()
                .map(|row| Ok((machine(row, 0)?, (row.count(1)?, row.text(2)?.to_owned()))))
                .collect()
        })
    }

    /// The machines under whose keys nothing shall stand, with the version that was taken back.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn cleared(&self) -> Result<Vec<(MachineId, u64)>, StoreError> {
        self.read(|database| {
            let rows =
                database.rows("SELECT machine, version FROM desired WHERE value = ''", &[])?;
            rows.iter()
                .map(|row| Ok((machine(row, 0)?, row.count(1)?)))
                .collect()
        })
    }

    /// Writes what is known of machines, all of it or nothing. The running centre writes it with the messages that it came
    /// from; this is for programs that have it from elsewhere.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn put_live(&self, lives: &[Live]) -> Result<(), StoreError> {
        self.write(|database| {
            for live in lives {
                ingest::put_live(database, live)?;
            }
            Ok(())
        })
    }
}
