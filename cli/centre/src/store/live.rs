//! What machines run now, for all of them at once.

use super::{Store, StoreError, ingest};
use crate::records::Live;

impl Store {
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
