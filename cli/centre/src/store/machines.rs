//! Machines in the store.

use serde_json::json;
use volcomp_fleet::MachineId;

use super::{Database, Store, StoreError, audit};
use crate::records::Machine;

/// A machine, as it stands in a transaction.
pub(crate) fn machine_named(
    database: &mut Database,
    machine: &MachineId,
) -> Result<Option<Machine>, StoreError> {
    let row = database.first(
        "SELECT document FROM machines WHERE machine = ?1",
        &[machine.as_str().into()],
    )?;
    row.map(|row| row.json(0)).transpose()
}

fn put(database: &mut Database, machine: &Machine, by: &str) -> Result<(), StoreError> {
    let name = machine.identity.machine.as_str();
    database.execute(
        "INSERT INTO machines (machine, site, document) VALUES (?1, ?2, ?3)
         ON CONFLICT (machine) DO UPDATE SET site = excluded.site, document = excluded.document",
        &[
            name.into(),
            machine.identity.site.as_str().into(),
            serde_json::to_string(machine)?.into(),
        ],
    )?;
    audit::append(database, by, "machine.put", name, json!(machine))
}

impl Store {
    /// Registers a machine, or changes what is known of it.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn put_machine(&self, machine: &Machine, by: &str) -> Result<(), StoreError> {
        self.write(|database| put(database, machine, by))
    }

    /// Changes what is known of a machine, as it stands in the transaction: what others change at the same time stays.
    ///
    /// # Errors
    /// Those of the change. Or: the database takes no change (its disk is full, another program holds it, its server is gone). Then nothing of it is changed.
    pub fn change_machine<E: From<StoreError>>(
        &self,
        machine: &MachineId,
        by: &str,
        change: impl FnOnce(Option<Machine>) -> Result<Machine, E>,
    ) -> Result<Machine, E> {
        self.write_or(|database| {
            let changed = change(machine_named(database, machine)?)?;
            put(database, &changed, by)?;
            Ok(changed)
        })
    }

    /// A machine.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn machine(&self, machine: &MachineId) -> Result<Option<Machine>, StoreError> {
        self.read(|database| machine_named(database, machine))
    }

    /// Every machine, by its name.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn machines(&self) -> Result<Vec<Machine>, StoreError> {
        self.read(|database| {
            let rows = database.rows("SELECT document FROM machines ORDER BY machine", &[])?;
            rows.iter().map(|row| row.json(0)).collect()
        })
    }

    /// Forgets a machine. Its versions and its history stay. Tells whether it was there.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn remove_machine(&self, machine: &MachineId, by: &str) -> Result<bool, StoreError> {
        self.write(|database| {
            let name = || vec![machine.as_str().into()];
            let removed = database.execute("DELETE FROM machines WHERE machine = ?1", &name())?;
            database.execute("DELETE FROM live WHERE machine = ?1", &name())?;
            if removed > 0 {
                audit::append(database, by, "machine.remove", machine.as_str(), json!({}))?;
            }
            Ok(removed > 0)
        })
    }
}
