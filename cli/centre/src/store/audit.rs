//! The centre's own audit log: every change with its author, each record chained to the previous one by its hash.

use rusqlite::{Connection, Row, params};
use serde_json::Value as Json;
use sha2::{Digest, Sha256};

use crate::{
    Error,
    clock::now_s,
    records::AuditRecord,
    store::{Store, execute, first, json, rows},
};

/// Appends a record in the transaction of the change that it describes.
pub(crate) fn append(
    database: &Connection,
    by: &str,
    action: &str,
    object: &str,
    details: Json,
) -> Result<(), Error> {
    let sql = "SELECT number, hash FROM audit ORDER BY number DESC LIMIT 1";
    let last = first(database, sql, [], |row| Ok((row.get(0)?, row.get(1)?)))?;
    let (last, before): (u64, String) = last.unwrap_or_default();
    let number = last + 1;
    let document = serde_json::to_string(&AuditRecord {
        number,
        at_s: now_s(),
        by: by.to_owned(),
        action: action.to_owned(),
        object: object.to_owned(),
        details,
        hash: String::new(),
    })?;
    let hash = hash(&before, &document);
    execute(
        database,
        "INSERT INTO audit (number, document, hash) VALUES (?1, ?2, ?3)",
        params![number, document, hash],
    )?;
    Ok(())
}

/// Hash of a record's stored text and of the hash `before` of the previous record.
fn hash(before: &str, document: &str) -> String {
    let mut digest = Sha256::new();
    digest.update(before);
    digest.update(document);
    volcomp_model::hexadecimal(&digest.finalize())
}

fn record(row: &Row<'_>) -> Result<AuditRecord, Error> {
    let record: AuditRecord = json(row, 0)?;
    let hash = row.get(1)?;
    Ok(AuditRecord { hash, ..record })
}

impl Store {
    pub fn audit(&self, by: &str, action: &str, object: &str, details: Json) -> Result<(), Error> {
        self.write(|database| append(database, by, action, object, details))
    }

    /// At most `count` records with numbers below `before`, the newest first. `None`: starts at the newest record.
    pub fn audit_records(
        &self,
        before: Option<u64>,
        count: u32,
    ) -> Result<Vec<AuditRecord>, Error> {
        let before = before.map_or(i64::MAX, |number| i64::try_from(number).unwrap_or(i64::MAX));
        self.read(|database| {
            let sql =
                "SELECT document, hash FROM audit WHERE number < ?1 ORDER BY number DESC LIMIT ?2";
            rows(database, sql, params![before, count], record)
        })
    }

    /// Verifies the hash chain of the whole log; returns the number of the first record that does not match its predecessor.
    pub fn broken_audit(&self) -> Result<Option<u64>, Error> {
        const PAGE: u64 = 1000;
        let sql =
            "SELECT document, hash, number FROM audit WHERE number >= ?1 ORDER BY number LIMIT ?2";
        let mut before = String::new();
        let mut expected: u64 = 1;
        loop {
            let page = self.read(|database| {
                rows(database, sql, params![expected, PAGE], |row| {
                    Ok((record(row)?, row.get::<_, String>(0)?, row.get::<_, u64>(2)?))
                })
            })?;
            if page.is_empty() {
                return Ok(None);
            }
            for (record, document, number) in page {
                let follows = record.number == expected
                    && number == expected
                    && record.hash == hash(&before, &document);
                if !follows {
                    return Ok(Some(expected));
                }
                before = record.hash;
                expected += 1;
            }
        }
    }
}
