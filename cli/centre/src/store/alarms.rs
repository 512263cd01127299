//! Alarms: open until what caused them has gone.

use volcomp_fleet::MachineId;

use super::{
    Store, StoreError, audit,
    database::{Database, Row, Value},
    models::machine,
};
use crate::records::{Alarm, AlarmKind};

const COLUMNS: &str = "id, machine, kind, text, since_s, until_s, seen_by";

fn alarm(row: &Row) -> Result<Alarm, StoreError> {
    let kind: AlarmKind = serde_json::from_value(row.text(2)?.into())?;
    Ok(Alarm {
        id: row.count(0)?,
        machine: row.optional(1, machine)?,
        kind,
        severity: kind.severity(),
        text: row.text(3)?.to_owned(),
        since_s: row.real(4)?,
        until_s: row.optional(5, Row::real)?,
        seen_by: row.optional(6, |row, column| row.text(column).map(str::to_owned))?,
    })
}

/// Opens an alarm.
pub(crate) fn raise(
    database: &mut Database,
    machine: Option<&MachineId>,
    kind: AlarmKind,
    text: &str,
    at_s: f64,
) -> Result<u64, StoreError> {
    let row = database.first("SELECT coalesce(max(id), 0) + 1 FROM alarms", &[])?;
    let id = row.map_or(Ok(1), |row| row.count(0))?;
    database.execute(
        "INSERT INTO alarms (id, machine, kind, text, since_s) VALUES (?1, ?2, ?3, ?4, ?5)",
        &[
            id.into(),
            machine.map(MachineId::as_str).into(),
            kind.name().into(),
            text.into(),
            at_s.into(),
        ],
    )?;
    Ok(id)
}

/// Closes an alarm.
pub(crate) fn clear(database: &mut Database, id: u64, at_s: f64) -> Result<(), StoreError> {
    database.execute(
        "UPDATE alarms SET until_s = ?2 WHERE id = ?1 AND until_s IS NULL",
        &[id.into(), at_s.into()],
    )?;
    Ok(())
}

/// Says more of an alarm that is open.
pub(crate) fn say(database: &mut Database, id: u64, text: &str) -> Result<(), StoreError> {
    database.execute(
        "UPDATE alarms SET text = ?2 WHERE id = ?1",
        &[id.into(), text.into()],
    )?;
    Ok(())
}

impl Store {
    /// The alarms that are open, the newest first.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn open_alarms(&self) -> Result<Vec<Alarm>, StoreError> {
        self.alarms_where("until_s IS NULL ORDER BY id DESC", &[])
    }

    /// The last `count` alarms, open or not, the newest first; of one machine, or of all.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn alarms(
        &self,
        machine: Option<&MachineId>,
        count: u32,
    ) -> Result<Vec<Alarm>, StoreError> {
        match machine {
            Some(machine) => self.alarms_where(
                "machine = ?1 ORDER BY id DESC LIMIT ?2",
                &[machine.as_str().into(), count.into()],
            ),
            None => self.alarms_where("id > 0 ORDER BY id DESC LIMIT ?1", &[count.into()]),
        }
    }

    fn alarms_where(&self, condition: &str, values: &[Value]) -> Result<Vec<Alarm>, StoreError> {
        self.read(|database| {
            let rows = database.rows(
                &format!("SELECT {COLUMNS} FROM alarms WHERE {condition}"),
                values,
            )?;
            rows.iter().map(alarm).collect()
        })
    }

    /// Writes down that somebody has seen an alarm. Tells whether there is such an alarm.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn see_alarm(&self, id: u64, by: &str) -> Result<bool, StoreError> {
        self.write(|database| {
            let seen = database.execute(
                "UPDATE alarms SET seen_by = ?2 WHERE id = ?1",
                &[id.into(), by.into()],
            )?;
            if seen > 0 {
                audit::append(
                    database,
                    by,
                    "alarm.see",
                    &id.to_string(),
                    serde_json::json!({}),
                )?;
            }
            Ok(seen > 0)
        })
    }
}
