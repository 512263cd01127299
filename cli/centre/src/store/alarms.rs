//! Alarms: open until their cause has ended.

use rusqlite::{Connection, Params, Row, params};
use serde_json::json;
use volcomp_fleet::MachineId;

use super::{
    Store, audit,
    database::{execute, machine, number, rows},
};
use crate::{
    Error,
    records::{Alarm, AlarmKind},
};

fn alarm(row: &Row<'_>) -> Result<Alarm, Error> {
    let kind: AlarmKind = serde_json::from_value(row.get::<_, String>(2)?.into())?;
    let name: Option<String> = row.get(1)?;
    Ok(Alarm {
        id: row.get(0)?,
        machine: name.map(|_| machine(row, 1)).transpose()?,
        kind,
        severity: kind.severity(),
        text: row.get(3)?,
        since_s: row.get(4)?,
        until_s: row.get(5)?,
        seen_by: row.get(6)?,
    })
}

pub(crate) fn raise(
    database: &Connection,
    machine: Option<&MachineId>,
    kind: AlarmKind,
    text: &str,
    at_s: f64,
) -> Result<(), Error> {
    let id = number(database, "SELECT coalesce(max(id), 0) + 1 FROM alarms", [])?;
    execute(
        database,
        "INSERT INTO alarms (id, machine, kind, text, since_s) VALUES (?1, ?2, ?3, ?4, ?5)",
        params![id, machine.map(MachineId::as_str), kind.name(), text, at_s],
    )?;
    Ok(())
}

pub(crate) fn clear(database: &Connection, id: u64, at_s: f64) -> Result<(), Error> {
    let sql = "UPDATE alarms SET until_s = ?2 WHERE id = ?1 AND until_s IS NULL";
    execute(database, sql, params![id, at_s]).map(|_| ())
}

pub(crate) fn set_text(database: &Connection, id: u64, text: &str) -> Result<(), Error> {
    let sql = "UPDATE alarms SET text = ?2 WHERE id = ?1";
    execute(database, sql, params![id, text]).map(|_| ())
}

impl Store {
    /// Open alarms, the newest first.
    pub fn open_alarms(&self) -> Result<Vec<Alarm>, Error> {
        self.alarms_where("until_s IS NULL ORDER BY id DESC", [])
    }

    /// The last `count` alarms, open or closed, the newest first; `None`: of all machines.
    pub fn alarms(&self, machine: Option<&MachineId>, count: u32) -> Result<Vec<Alarm>, Error> {
        self.alarms_where(
            "?1 IS NULL OR machine = ?1 ORDER BY id DESC LIMIT ?2",
            params![machine.map(MachineId::as_str), count],
        )
    }

    fn alarms_where(&self, condition: &str, values: impl Params) -> Result<Vec<Alarm>, Error> {
        let sql = format!(
            "SELECT id, machine, kind, text, since_s, until_s, seen_by FROM alarms WHERE {condition}"
        );
        self.read(|database| rows(database, &sql, values, alarm))
    }

    /// Records who has acknowledged an alarm. `false` if the alarm does not exist.
    pub fn acknowledge_alarm(&self, id: u64, by: &str) -> Result<bool, Error> {
        self.write(|database| {
            let sql = "UPDATE alarms SET seen_by = ?2 WHERE id = ?1";
            let is_there = execute(database, sql, params![id, by])? > 0;
            if is_there {
                audit::append(database, by, "alarm.see", &id.to_string(), json!({}))?;
            }
            Ok(is_there)
        })
    }
}
