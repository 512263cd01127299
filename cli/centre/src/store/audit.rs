//! The centre's own audit log: every change, with its author, each record chained to the one before by its hash.

use serde_json::Value as Json;
use sha2::{Digest, Sha256};

use super::{Store, StoreError, database::Database};
use crate::{clock::now_s, records::AuditRecord};

/// Appends a record, in the transaction of what it tells.
pub(crate) fn append(
    database: &mut dyn Database,
    by: &str,
    action: &str,
    object: &str,
    details: Json,
) -> Result<(), StoreError> {
    let last = database.first(
        "SELECT document FROM audit ORDER BY number DESC LIMIT 1",
        &[],
    )?;
    let last: Option<AuditRecord> = last.map(|row| row.json(0)).transpose()?;
    let (number, before) = last.map_or((1, String::new()), |last| (last.number + 1, last.hash));
    let mut record = AuditRecord {
        number,
        at_s: now_s(),
        by: by.to_owned(),
        action: action.to_owned(),
        object: object.to_owned(),
        details,
        hash: String::new(),
    };
    record.hash = hash(&before, &record)?;
    database.execute(
        "INSERT INTO audit (number, document) VALUES (?1, ?2)",
        &[number.into(), serde_json::to_string(&record)?.into()],
    )?;
    Ok(())
}

/// The hash of a record after one with the hash `before`.
fn hash(before: &str, record: &AuditRecord) -> Result<String, StoreError> {
    let bare = AuditRecord {
        hash: String::new(),
        ..record.clone()
    };
    let mut digest = Sha256::new();
    digest.update(before);
    digest.update(serde_json::to_vec(&bare)?);
    Ok(crate::hex(&digest.finalize()))
}

impl Store {
    /// Writes down what somebody did, where it changes nothing else in the store.
    ///
    /// # Errors
    /// The database refuses.
    pub fn audit(
        &self,
        by: &str,
        action: &str,
        object: &str,
        details: Json,
    ) -> Result<(), StoreError> {
        self.write(|database| append(database, by, action, object, details))
    }

    /// At most `count` records with numbers below `before`, the newest first; `None`: from the newest.
    ///
    /// # Errors
    /// The database refuses.
    pub fn audit_records(
        &self,
        before: Option<u64>,
        count: u32,
    ) -> Result<Vec<AuditRecord>, StoreError> {
        self.read(|database| {
            let rows = database.rows(
                "SELECT document FROM audit WHERE number < ?1 ORDER BY number DESC LIMIT ?2",
                &[before.unwrap_or(u64::MAX).into(), count.into()],
            )?;
            rows.iter().map(|row| row.json(0)).collect()
        })
    }

    /// Checks the chain of the whole log: the number of the first record that does not follow from the one before.
    ///
    /// # Errors
    /// The database refuses.
    pub fn broken_audit(&self) -> Result<Option<u64>, StoreError> {
        const PAGE: u64 = 1000;
        let mut before = String::new();
        let mut expected = 1;
        loop {
            let rows = self.read(|database| {
                database.rows(
                    "SELECT number, document FROM audit WHERE number >= ?1 ORDER BY number LIMIT ?2",
                    &[expected.into(), PAGE.into()],
                )
            })?;
            if rows.is_empty() {
                return Ok(None);
            }
            for row in rows {
                let record: AuditRecord = row.json(1)?;
                let follows = record.number == expected
                    && row.count(0)? == expected
                    && record.hash == hash(&before, &record)?;
                if !follows {
                    return Ok(Some(expected));
                }
                before = record.hash;
                expected += 1;
            }
        }
    }
}
