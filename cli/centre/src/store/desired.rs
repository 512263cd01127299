//! What stands under the keys of machines: of each the newest signed value, or that there is none.

use std::collections::HashMap;

use serde_json::json;
use volcomp_fleet::MachineId;

use super::{
    Store, StoreError, audit,
    database::{Database, Row},
    models::machine,
};
use crate::records::Version;

/// A row without bytes says that nothing stands under the key: what was issued last was taken back, and there was nothing before.
const NONE: &str = "";
const HAS_NONE: &str = "desired.value = ''";
const HAS_VALUE: &str = "desired.value <> ''";
/// The documents of the newest versions.
const NEWEST_VERSIONS: &str = "SELECT versions.document FROM desired JOIN versions
    ON versions.machine = desired.machine AND versions.version = desired.version";

/// The newest signed value of a machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Issued {
    /// The machine.
    pub machine: MachineId,
    /// The version in it.
    pub version: u64,
    /// The checksum of its model.
    pub model: String,
    /// The bytes that stand under the machine's key.
    pub value: String,
}

impl Store {
    /// What a machine shall run: its newest signed value.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn issued(&self, machine: &MachineId) -> Result<Option<Issued>, StoreError> {
        self.read(|database| newest(database, machine))
    }

    /// The newest version of every machine, with what became of it.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn newest_versions(&self) -> Result<Vec<Version>, StoreError> {
        self.read(|database| {
            let rows = database.rows(&format!("{NEWEST_VERSIONS} WHERE {HAS_VALUE}"), &[])?;
            rows.iter().map(|row| row.json(0)).collect()
        })
    }

    /// What every machine shall run: the newest version and the checksum of its model, without the signed values, which are
    /// large.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn wanted(&self) -> Result<HashMap<MachineId, (u64, String)>, StoreError> {
        self.read(|database| {
            let rows = database.rows(
                &format!("SELECT machine, version, model FROM desired WHERE {HAS_VALUE}"),
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
            let rows = database.rows(
                &format!("SELECT machine, version FROM desired WHERE {HAS_NONE}"),
                &[],
            )?;
            rows.iter()
                .map(|row| Ok((machine(row, 0)?, row.count(1)?)))
                .collect()
        })
    }
}

/// What a machine shall run, as it stands in a transaction.
pub(crate) fn newest(
    database: &mut Database,
    machine: &MachineId,
) -> Result<Option<Issued>, StoreError> {
    let row = database.first(
        &format!(
            "SELECT machine, version, model, value FROM desired WHERE machine = ?1 AND {HAS_VALUE}"
        ),
        &[machine.as_str().into()],
    )?;
    row.as_ref().map(issued).transpose()
}

/// Has nothing stand under the key of a machine: what was issued last is taken back, and there was nothing before. It is so until the
/// next one is issued.
pub(crate) fn clear_desired(
    database: &mut Database,
    machine: &MachineId,
) -> Result<(), StoreError> {
    database.execute(
        "UPDATE desired SET value = ?2 WHERE machine = ?1",
        &[machine.as_str().into(), NONE.into()],
    )?;
    audit::append(
        database,
        "centre",
        "version.withdraw",
        machine.as_str(),
        json!({}),
    )
}

/// The newest version of a machine, as it stands in a transaction.
pub(crate) fn newest_version(
    database: &mut Database,
    machine: &MachineId,
) -> Result<Option<Version>, StoreError> {
    let row = database.first(
        &format!("{NEWEST_VERSIONS} WHERE desired.machine = ?1 AND {HAS_VALUE}"),
        &[machine.as_str().into()],
    )?;
    row.map(|row| row.json(0)).transpose()
}

fn issued(row: &Row) -> Result<Issued, StoreError> {
    Ok(Issued {
        machine: machine(row, 0)?,
        version: row.count(1)?,
        model: row.text(2)?.to_owned(),
        value: row.text(3)?.to_owned(),
    })
}
