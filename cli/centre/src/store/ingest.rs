//! What machines have said, in the store.

use volcomp_fleet::MachineId;

use super::{Store, StoreError, database::Database, models::machine};
use crate::{instance::Instance, records::Live};

pub(crate) use super::models::answer;

/// An hour, s.
const HOUR_S: f64 = 3600.0;

pub(crate) fn add_recent(
    database: &mut Database,
    machine: &MachineId,
    at_s: f64,
    document: String,
) -> Result<(), StoreError> {
    database.execute(
        "INSERT INTO recent (machine, at_s, document) VALUES (?1, ?2, ?3)",
        &[machine.into(), at_s.into(), document.into()],
    )?;
    Ok(())
}

pub(crate) fn add_telemetry(
    database: &mut Database,
    machine: &MachineId,
    at_s: f64,
    document: &str,
) -> Result<(), StoreError> {
    let hour_s = (at_s / HOUR_S).floor() * HOUR_S;
    database.execute(
        "INSERT INTO telemetry (machine, at_s, hourly, document) VALUES (?1, ?2,
         CASE WHEN EXISTS (SELECT 1 FROM telemetry WHERE machine = ?1 AND at_s >= ?3) THEN 0 ELSE 1 END, ?4)",
        &[machine.into(), at_s.into(), hour_s.into(), document.into()],
    )?;
    Ok(())
}

/// Adds a record, where there is none of the machine with its key.
pub(crate) fn add_record(
    database: &mut Database,
    machine: &MachineId,
    at_s: f64,
    document: &str,
    key: Option<String>,
) -> Result<(), StoreError> {
    database.execute(
        "INSERT INTO records (machine, at_s, document, record) VALUES (?1, ?2, ?3, ?4)
         ON CONFLICT (machine, record) DO NOTHING",
        &[machine.into(), at_s.into(), document.into(), key.into()],
    )?;
    Ok(())
}

pub(crate) fn put_live(database: &mut Database, live: &Live) -> Result<(), StoreError> {
    database.execute(
        "INSERT INTO live (machine, document) VALUES (?1, ?2)
         ON CONFLICT (machine) DO UPDATE SET document = excluded.document",
        &[(&live.machine).into(), serde_json::to_string(live)?.into()],
    )?;
    Ok(())
}

pub(crate) fn put_instance(
    database: &mut Database,
    machine: &MachineId,
    instance: &Instance,
) -> Result<(), StoreError> {
    database.execute(
        "INSERT INTO instances (machine, instance, first_s, document) VALUES (?1, ?2, ?3, ?4)
         ON CONFLICT (machine, instance) DO UPDATE SET document = excluded.document",
        &[
            machine.into(),
            instance.instance.as_str().into(),
            instance.first_s.into(),
            serde_json::to_string(instance)?.into(),
        ],
    )?;
    Ok(())
}

pub(crate) fn remove_instance(
    database: &mut Database,
    machine: &MachineId,
    instance: &str,
) -> Result<(), StoreError> {
    database.execute(
        "DELETE FROM instances WHERE machine = ?1 AND instance = ?2",
        &[machine.into(), instance.into()],
    )?;
    Ok(())
}

impl Store {
    /// What is known of every machine that was ever heard.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn live(&self) -> Result<Vec<Live>, StoreError> {
        self.read(|database| {
            let rows = database.rows("SELECT document FROM live ORDER BY machine", &[])?;
            rows.iter().map(|row| row.json(0)).collect()
        })
    }

    /// The gateways of every machine, each machine's in the order in which they were heard first.
    pub(crate) fn instances(&self) -> Result<Vec<(MachineId, Instance)>, StoreError> {
        self.read(|database| {
            let rows = database.rows(
                "SELECT machine, document FROM instances ORDER BY machine, first_s",
                &[],
            )?;
            rows.iter()
                .map(|row| Ok((machine(row, 0)?, row.json(1)?)))
                .collect()
        })
    }

    /// The last `count` audit records of a machine with the times at which they were made, the newest first.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn machine_records(
        &self,
        of: &MachineId,
        count: u32,
    ) -> Result<Vec<(f64, serde_json::Value)>, StoreError> {
        self.read(|database| {
            let rows = database.rows(
                "SELECT at_s, document FROM records WHERE machine = ?1 ORDER BY at_s DESC LIMIT ?2",
                &[of.into(), count.into()],
            )?;
            rows.iter()
                .map(|row| Ok((row.real(0)?, row.json_or_text(1)?)))
                .collect()
        })
    }
}
