//! The centre's own audit log: every change, with its author, each record chained to the one before by its hash.

use serde_json::Value as Json;
use sha2::{Digest, Sha256};

use super::{
    Store, StoreError,
    database::{Database, Row},
};
use crate::{clock::now_s, records::AuditRecord};

/// Appends a record, in the transaction of what it tells.
pub(crate) fn append(
    database: &mut Database,
    by: &str,
    action: &str,
    object: &str,
    details: Json,
) -> Result<(), StoreError> {
    let last = database.first(
        "SELECT number, hash FROM audit ORDER BY number DESC LIMIT 1",
        &[],
    )?;
    let (number, before) = match &last {
        Some(row) => (row.count(0)? + 1, row.text(1)?),
        None => (1, ""),
    };
    let document = serde_json::to_string(&AuditRecord {
        number,
        at_s: now_s(),
        by: by.to_owned(),
        action: action.to_owned(),
        object: object.to_owned(),
        details,
        hash: String::new(),
    })?;
    let hash = hash(before, &document);
    database.execute(
        "INSERT INTO audit (number, document, hash) VALUES (?1, ?2, ?3)",
        &[number.into(), document.into(), hash.into()],
    )?;
    Ok(())
}

/// The hash of a record, as the text that is stored, after one with the hash `before`.
fn hash(before: &str, document: &str) -> String {
    let mut digest = Sha256::new();
    digest.update(before);
    digest.update(document);
    crate::hex(&digest.finalize())
}

fn record(row: &Row) -> Result<AuditRecord, StoreError> {
    let mut record: AuditRecord = row.json(0)?;
    row.text(1)?.clone_into(&mut record.hash);
    Ok(record)
}

impl Store {
    /// Writes down what somebody did, where it changes nothing else in the store.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
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
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn audit_records(
        &self,
        before: Option<u64>,
        count: u32,
    ) -> Result<Vec<AuditRecord>, StoreError> {
        self.read(|database| {
            let rows = database.rows(
                "SELECT document, hash FROM audit WHERE number < ?1 ORDER BY number DESC LIMIT ?2",
                &[before.unwrap_or(u64::MAX).into(), count.into()],
            )?;
            rows.iter().map(record).collect()
        })
    }

    /// Checks the chain of the whole log: the number of the first record that does not follow from the one before.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn broken_audit(&self) -> Result<Option<u64>, StoreError> {
        const PAGE: u64 = 1000;
        let mut before = String::new();
        let mut expected = 1;
        loop {
            let rows = self.read(|database| {
                database.rows(
                    "SELECT document, hash, number FROM audit WHERE number >= ?1 ORDER BY number LIMIT ?2",
                    &[expected.into(), PAGE.into()],
                )
            })?;
            if rows.is_empty() {
                return Ok(None);
            }
            for row in rows {
                let record = record(&row)?;
                let follows = record.number == expected
                    && row.count(2)? == expected
                    && record.hash == hash(&before, row.text(0)?);
                if !follows {
                    return Ok(Some(expected));
                }
                before = record.hash;
                expected += 1;
            }
        }
    }
}
