//! History of the machines: conditions, telemetry, audit records, gateway instances and alarms.
//!
//! By default (`Retention`), every condition is kept for a day, one-minute means for a month, and one-hour means
//! indefinitely. Conditions are collected in `recent` until their minute is closed. Closing it adds one row to `raw`
//! and one to `minutes`, and updates the hour, in one transaction. Each condition is thus written exactly twice, and
//! the database stays consistent after a crash.
//!
//! Alarms are open until their cause has ended.

use rusqlite::{Connection, Params, Row, params};
use serde::{Deserialize, de::DeserializeOwned};
use serde_json::json;
use volcomp_fleet::MachineId;

use crate::{
    Error,
    instance::Instance,
    records::{Alarm, AlarmKind, Point, Resolution},
    store::{Store, audit, execute, first, json, json_or_text, machine, number, rows},
};

const HOUR_S: f64 = 3600.0;
const DAY_S: f64 = 86_400.0;

/// The table `[keep]`: retention times of the history. One-hour means are kept indefinitely.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct Retention {
    /// Time for which every condition is kept, hours.
    pub raw_h: f64,
    /// Time for which one-minute means are kept, days.
    pub minutes_d: f64,
    /// Time for which every full telemetry message is kept, hours.
    pub telemetry_h: f64,
    /// Time for which one full telemetry message an hour is kept, days.
    pub telemetry_hourly_d: f64,
}

impl Default for Retention {
    fn default() -> Self {
        Self { raw_h: 24.0, minutes_d: 31.0, telemetry_h: 24.0, telemetry_hourly_d: 31.0 }
    }
}

const MAX_MACHINES_PER_WRITE: usize = 32;

/// Index of the minute or hour that contains a time.
#[expect(clippy::cast_possible_truncation, reason = "a float is cut to the range of i64")]
fn place(at_s: f64, length_s: f64) -> i64 {
    (at_s / length_s).floor() as i64
}

impl Store {
    /// Moves the conditions of all minutes that ended before `until_s` (s since 1970) from the table `recent` to `raw`,
    /// and updates the means of their minutes and hours. For each machine, the oldest minute is first. Returns the
    /// number of conditions moved. A transaction holds one minute of a few machines, so its memory use does not grow
    /// with the number of machines.
    pub fn close_minutes(&self, until_s: f64) -> Result<u64, Error> {
        let end = place(until_s, 60.0);
        // Every machine with conditions has a gateway instance, so no machine is missed.
        let sql = "SELECT DISTINCT machine FROM instances ORDER BY machine";
        let machines: Vec<String> =
            self.read(|database| rows(database, sql, [], |row| Ok(row.get(0)?)))?;
        let mut count = 0;
        for together in machines.chunks(MAX_MACHINES_PER_WRITE) {
            loop {
                let closed = self.write(|database| {
                    together.iter().try_fold(0, |closed, machine| {
                        Ok(closed + close_oldest(database, machine, end)?)
                    })
                })?;
                if closed == 0 {
                    break;
                }
                count += closed;
            }
        }
        Ok(count)
    }

    /// History of a machine from `from_s` to `to_s`: the newest `count` points, in ascending order of time.
    pub fn history(
        &self,
        machine: &MachineId,
        resolution: Resolution,
        from_s: f64,
        to_s: f64,
        count: u32,
    ) -> Result<Vec<Point>, Error> {
        let (table, column, length_s) = match resolution {
            Resolution::Raw => ("raw", "minute", 60.0),
            Resolution::Minute => ("minutes", "minute", 60.0),
            Resolution::Hour => ("hours", "hour", HOUR_S),
        };
        let name = machine.as_str();
        let sql = format!(
            "SELECT document FROM {table} WHERE machine = ?1 AND {column} >= ?2 AND {column} <= ?3
             ORDER BY {column} DESC LIMIT ?4"
        );
        let range = params![name, place(from_s, length_s), place(to_s, length_s), count];
        self.read(|database| {
            if resolution != Resolution::Raw {
                let mut points = readable(database, name, table, &sql, range)?;
                points.reverse();
                return Ok(points);
            }
            let minutes: Vec<Vec<Point>> = readable(database, name, table, &sql, range)?;
            let mut points: Vec<Point> = minutes.into_iter().flatten().collect();
            // Conditions of minutes that are not closed yet.
            let sql = "SELECT document FROM recent WHERE machine = ?1 AND at_s >= ?2 AND at_s <= ?3 ORDER BY at_s";
            let recent: Vec<Point> =
                readable(database, name, "recent", sql, params![name, from_s, to_s])?;
            points.extend(recent);
            points.retain(|point| (from_s..=to_s).contains(&point.at_s));
            points.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
            let most = usize::try_from(count).unwrap_or(usize::MAX);
            points.drain(..points.len().saturating_sub(most));
            Ok(points)
        })
    }

    pub fn telemetry(
        &self,
        machine: &MachineId,
    ) -> Result<Option<(f64, serde_json::Value)>, Error> {
        let sql =
            "SELECT at_s, document FROM telemetry WHERE machine = ?1 ORDER BY at_s DESC LIMIT 1";
        self.read(|database| {
            first(database, sql, [machine.as_str()], |row| Ok((row.get(0)?, json_or_text(row, 1)?)))
        })
    }

    /// The last `count` audit records of a machine with their creation times, the newest first.
    pub fn machine_records(
        &self,
        of: &MachineId,
        count: u32,
    ) -> Result<Vec<(f64, serde_json::Value)>, Error> {
        let sql =
            "SELECT at_s, document FROM records WHERE machine = ?1 ORDER BY at_s DESC LIMIT ?2";
        self.read(|database| {
            rows(database, sql, params![of.as_str(), count], |row| {
                Ok((row.get(0)?, json_or_text(row, 1)?))
            })
        })
    }

    /// Deletes expired data, machine by machine in separate transactions to keep lock times short. Their age counts from the machine's newest minute
    /// if that is before `now_s`, so that a clock that was set too far deletes nothing.
    pub fn delete_expired(&self, keep: Retention, now_s: f64) -> Result<(), Error> {
        let sql = "SELECT machine FROM live";
        let machines: Vec<String> =
            self.read(|database| rows(database, sql, [], |row| Ok(row.get(0)?)))?;
        for machine in machines {
            self.write(|database| {
                let sql = "SELECT max(minute) FROM minutes WHERE machine = ?1";
                let newest = first(database, sql, [&machine], |row| Ok(row.get(0)?))?;
                let newest: Option<i64> = newest.flatten();
                let now_s = newest.map_or(now_s, |newest| now_s.min(newest as f64 * 60.0));
                for (table, kept_s) in
                    [("raw", keep.raw_h * HOUR_S), ("minutes", keep.minutes_d * DAY_S)]
                {
                    execute(
                        database,
                        &format!("DELETE FROM {table} WHERE machine = ?1 AND minute < ?2"),
                        params![machine, place(now_s - kept_s, 60.0)],
                    )?;
                }
                for (which, kept_s) in [
                    (" AND hourly = 0", keep.telemetry_h * HOUR_S),
                    ("", keep.telemetry_hourly_d * DAY_S),
                ] {
                    execute(
                        database,
                        &format!("DELETE FROM telemetry WHERE machine = ?1 AND at_s < ?2{which}"),
                        params![machine, now_s - kept_s],
                    )?;
                }
                Ok(())
            })?;
        }
        Ok(())
    }

    /// Gateway instances of every machine, in the order in which they first appeared.
    pub(crate) fn instances(&self) -> Result<Vec<(MachineId, Instance)>, Error> {
        let sql = "SELECT machine, document FROM instances ORDER BY machine, first_s";
        self.read(|database| rows(database, sql, [], |row| Ok((machine(row, 0)?, json(row, 1)?))))
    }
}

/// Closes a machine's oldest open minute before `end` and returns the number of its conditions.
fn close_oldest(database: &Connection, machine: &str, end: i64) -> Result<u64, Error> {
    let sql = "SELECT min(at_s) FROM recent WHERE machine = ?1";
    let oldest = first(database, sql, [machine], |row| Ok(row.get::<_, Option<f64>>(0)?))?;
    let oldest = oldest.flatten().map(|at_s| place(at_s, 60.0));
    let Some(minute) = oldest.filter(|minute| *minute < end) else {
        return Ok(0);
    };
    let from_s = minute as f64 * 60.0;
    let range = params![machine, from_s, from_s + 60.0];
    let sql =
        "SELECT document FROM recent WHERE machine = ?1 AND at_s >= ?2 AND at_s < ?3 ORDER BY at_s";
    let new: Vec<Point> = readable(database, machine, "recent", sql, range)?;
    close_one(database, machine, minute, new)?;
    let sql = "DELETE FROM recent WHERE machine = ?1 AND at_s >= ?2 AND at_s < ?3";
    Ok(execute(database, sql, range)? as u64)
}

fn close_one(
    database: &Connection,
    machine: &str,
    minute: i64,
    mut points: Vec<Point>,
) -> Result<(), Error> {
    let raw: Option<Vec<Point>> = kept(database, "raw", "minute", machine, minute)?;
    if let Some(before) = raw {
        points.extend(before);
        points.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
    }
    put(database, "raw", "minute", machine, minute, &points)?;
    let Some(mean) = Point::mean(&points, minute as f64 * 60.0) else {
        return Ok(());
    };
    let before: Option<Point> = kept(database, "minutes", "minute", machine, minute)?;
    if before.as_ref().is_some_and(|before| before.count > mean.count) {
        // The raw conditions of this minute have expired, and a late one has arrived: keep the mean of the earlier
        // conditions.
        return Ok(());
    }
    put(database, "minutes", "minute", machine, minute, &mean)?;
    let hour = minute.div_euclid(60);
    let shares = if before.is_none() {
        let so_far: Option<Point> = kept(database, "hours", "hour", machine, hour)?;
        so_far.into_iter().chain([mean]).collect()
    } else {
        let sql = "SELECT document FROM minutes WHERE machine = ?1 AND minute >= ?2 AND minute < ?3 ORDER BY minute";
        let range = params![machine, hour * 60, hour * 60 + 60];
        readable(database, machine, "minutes", sql, range)?
    };
    if let Some(of_hour) = Point::mean(&shares, hour as f64 * HOUR_S) {
        put(database, "hours", "hour", machine, hour, &of_hour)?;
    }
    Ok(())
}

fn kept<T: DeserializeOwned>(
    database: &Connection,
    table: &str,
    column: &str,
    machine: &str,
    place: i64,
) -> Result<Option<T>, Error> {
    let sql = format!("SELECT document FROM {table} WHERE machine = ?1 AND {column} = ?2");
    let mut found = readable(database, machine, table, &sql, params![machine, place])?;
    Ok(found.pop())
}

/// Documents of a query. Unreadable documents are logged and skipped, so that they do not block the history.
fn readable<T: DeserializeOwned>(
    database: &Connection,
    machine: &str,
    table: &str,
    sql: &str,
    values: impl Params,
) -> Result<Vec<T>, Error> {
    let documents = rows(database, sql, values, |row| Ok(json(row, 0)))?;
    let read = |document: Result<T, Error>| {
        let warn = |error: &Error| {
            tracing::warn!("{machine}: an unreadable row of the table {table} is skipped: {error}");
        };
        document.inspect_err(warn).ok()
    };
    Ok(documents.into_iter().filter_map(read).collect())
}

fn put(
    database: &Connection,
    table: &str,
    column: &str,
    machine: &str,
    place: i64,
    document: &impl serde::Serialize,
) -> Result<(), Error> {
    execute(
        database,
        &format!(
            "INSERT INTO {table} (machine, {column}, document) VALUES (?1, ?2, ?3)
             ON CONFLICT (machine, {column}) DO UPDATE SET document = excluded.document"
        ),
        params![machine, place, serde_json::to_string(document)?],
    )?;
    Ok(())
}

pub(crate) fn add_recent(
    database: &Connection,
    machine: &MachineId,
    at_s: f64,
    document: &str,
) -> Result<(), Error> {
    let sql = "INSERT INTO recent (machine, at_s, document) VALUES (?1, ?2, ?3)";
    execute(database, sql, params![machine.as_str(), at_s, document]).map(|_| ())
}

pub(crate) fn add_telemetry(
    database: &Connection,
    machine: &MachineId,
    at_s: f64,
    document: &str,
) -> Result<(), Error> {
    let hour_s = (at_s / HOUR_S).floor() * HOUR_S;
    execute(
        database,
        "INSERT INTO telemetry (machine, at_s, hourly, document) VALUES (?1, ?2,
         CASE WHEN EXISTS (SELECT 1 FROM telemetry WHERE machine = ?1 AND at_s >= ?3) THEN 0 ELSE 1 END, ?4)",
        params![machine.as_str(), at_s, hour_s, document],
    )?;
    Ok(())
}

/// Adds a record unless the machine already has one with the same key.
pub(crate) fn add_record(
    database: &Connection,
    machine: &MachineId,
    at_s: f64,
    document: &str,
    key: Option<&str>,
) -> Result<(), Error> {
    execute(
        database,
        "INSERT INTO records (machine, at_s, document, record) VALUES (?1, ?2, ?3, ?4)
         ON CONFLICT (machine, record) DO NOTHING",
        params![machine.as_str(), at_s, document, key],
    )?;
    Ok(())
}

pub(crate) fn put_instance(
    database: &Connection,
    machine: &MachineId,
    instance: &Instance,
) -> Result<(), Error> {
    let document = serde_json::to_string(instance)?;
    execute(
        database,
        "INSERT INTO instances (machine, instance, first_s, document) VALUES (?1, ?2, ?3, ?4)
         ON CONFLICT (machine, instance) DO UPDATE SET document = excluded.document",
        params![machine.as_str(), instance.instance, instance.first_s, document],
    )?;
    Ok(())
}

pub(crate) fn remove_instance(
    database: &Connection,
    machine: &MachineId,
    instance: &str,
) -> Result<(), Error> {
    let sql = "DELETE FROM instances WHERE machine = ?1 AND instance = ?2";
    execute(database, sql, [machine.as_str(), instance]).map(|_| ())
}

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
