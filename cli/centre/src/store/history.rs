//! The history of conditions: every one for a day, means of minutes for a month, means of hours for ever; and whole states.
//!
//! Conditions wait in `recent` until their minute is closed; then the minute becomes one row of `raw` and one of `minutes`,
//! and the hour gets its share, in one transaction. So a condition is written twice whatever becomes of it, and the database
//! that a crash leaves goes on where it was.

use volcomp_fleet::MachineId;

use super::{
    Store, StoreError,
    database::{Database, Row, Value},
};
use crate::{
    point,
    records::{Point, Resolution},
};

/// How long the history is kept, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keep {
    /// Every condition.
    pub raw_s: f64,
    /// Means of minutes.
    pub minutes_s: f64,
    /// Every whole state.
    pub telemetry_s: f64,
    /// One whole state an hour.
    pub telemetry_hourly_s: f64,
}

impl Default for Keep {
    /// A day of every condition and whole state, 31 days of minutes and of one whole state an hour. Hours are kept for ever.
    fn default() -> Self {
        const DAY: f64 = 86_400.0;
        Self {
            raw_s: DAY,
            minutes_s: 31.0 * DAY,
            telemetry_s: DAY,
            telemetry_hourly_s: 31.0 * DAY,
        }
    }
}

/// Minutes of so many machines are closed in one transaction.
const TOGETHER: usize = 32;

/// The minute or the hour of a time.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a float is cut to the range of i64"
)]
fn place(at_s: f64, length_s: f64) -> i64 {
    (at_s / length_s).floor() as i64
}

impl Store {
    /// Closes the minutes that ended before `until_s`, each machine's oldest first, and tells how many conditions were in them.
    /// A transaction holds one minute of a few machines: what it needs of memory does not grow with the shop.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn close_minutes(&self, until_s: f64) -> Result<u64, StoreError> {
        let end = place(until_s, 60.0);
        // Whoever has told a condition has told who it is.
        let machines = self.read(|database| {
            database.rows(
                "SELECT DISTINCT machine FROM instances ORDER BY machine",
                &[],
            )
        })?;
        let mut count = 0;
        for together in machines.chunks(TOGETHER) {
            loop {
                let closed = self.write(|database| {
                    let mut closed = 0;
                    for machine in together {
                        closed += close_oldest(database, &machine.0[0], end)?;
                    }
                    Ok(closed)
                })?;
                if closed == 0 {
                    break;
                }
                count += closed;
            }
        }
        Ok(count)
    }

    /// The history of a machine from `from_s` to `to_s`, the newest `count` points of it, the oldest first.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn history(
        &self,
        machine: &MachineId,
        resolution: Resolution,
        from_s: f64,
        to_s: f64,
        count: u32,
    ) -> Result<Vec<Point>, StoreError> {
        let (table, column, length_s) = match resolution {
            Resolution::Raw => ("raw", "minute", 60.0),
            Resolution::Minute => ("minutes", "minute", 60.0),
            Resolution::Hour => ("hours", "hour", 3600.0),
        };
        self.read(|database| {
            let rows = database.rows(
                &format!(
                    "SELECT document FROM {table} WHERE machine = ?1 AND {column} >= ?2 AND {column} <= ?3
                     ORDER BY {column} DESC LIMIT ?4"
                ),
                &[
                    machine.as_str().into(),
                    place(from_s, length_s).into(),
                    place(to_s, length_s).into(),
                    count.into(),
                ],
            )?;
            let name = machine.as_str();
            if resolution != Resolution::Raw {
                let mut points = readable(&rows, name, table);
                points.reverse();
                return Ok(points);
            }
            let minutes: Vec<Vec<Point>> = readable(&rows, name, table);
            let mut points: Vec<Point> = minutes.into_iter().flatten().collect();
            // What its minute has not been closed of.
            let recent = database.rows(
                "SELECT document FROM recent WHERE machine = ?1 AND at_s >= ?2 AND at_s <= ?3 ORDER BY at_s",
                &[machine.as_str().into(), from_s.into(), to_s.into()],
            )?;
            points.extend(readable::<Point>(&recent, name, "recent"));
            points.retain(|point| (from_s..=to_s).contains(&point.at_s));
            points.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
            let most = usize::try_from(count).unwrap_or(usize::MAX);
            points.drain(..points.len().saturating_sub(most));
            Ok(points)
        })
    }

    /// The last whole state of a machine, with its time.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn telemetry(
        &self,
        machine: &MachineId,
    ) -> Result<Option<(f64, serde_json::Value)>, StoreError> {
        self.read(|database| {
            let row = database.first(
                "SELECT at_s, document FROM telemetry WHERE machine = ?1 ORDER BY at_s DESC LIMIT 1",
                &[machine.as_str().into()],
            )?;
            row.map(|row| Ok((row.real(0)?, row.json_or_text(1)?))).transpose()
        })
    }

    /// Forgets what is older than it is kept. Machine by machine, each in a transaction of its own, so that nothing waits long.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn forget(&self, keep: Keep, now_s: f64) -> Result<u64, StoreError> {
        let rows = self.read(|database| database.rows("SELECT machine FROM live", &[]))?;
        let mut count = 0;
        for row in rows {
            let name = || Value::from(row.text(0).unwrap_or_default());
            count += self.write(|database| {
                let mut count = 0;
                for (table, kept_s) in [("raw", keep.raw_s), ("minutes", keep.minutes_s)] {
                    count += database.execute(
                        &format!("DELETE FROM {table} WHERE machine = ?1 AND minute < ?2"),
                        &[name(), place(now_s - kept_s, 60.0).into()],
                    )?;
                }
                for (sql, kept_s) in [
                    (
                        "DELETE FROM telemetry WHERE machine = ?1 AND at_s < ?2 AND hourly = 0",
                        keep.telemetry_s,
                    ),
                    (
                        "DELETE FROM telemetry WHERE machine = ?1 AND at_s < ?2",
                        keep.telemetry_hourly_s,
                    ),
                ] {
                    count += database.execute(sql, &[name(), (now_s - kept_s).into()])?;
                }
                Ok(count)
            })?;
        }
        Ok(count)
    }
}

/// Closes the oldest minute of a machine that is not closed and lies before `end`: how many conditions were in it.
fn close_oldest(database: &mut Database, machine: &Value, end: i64) -> Result<u64, StoreError> {
    let oldest = database.first(
        "SELECT min(at_s) FROM recent WHERE machine = ?1",
        std::slice::from_ref(machine),
    )?;
    let oldest = oldest.map_or(Ok(None), |row| row.optional(0, Row::real))?;
    let oldest = oldest.map(|at_s| place(at_s, 60.0));
    let Some(minute) = oldest.filter(|minute| *minute < end) else {
        return Ok(0);
    };
    let from_s = minute as f64 * 60.0;
    let range = [
        machine.clone(),
        Value::Real(from_s),
        Value::Real(from_s + 60.0),
    ];
    let rows = database.rows(
        "SELECT document FROM recent WHERE machine = ?1 AND at_s >= ?2 AND at_s < ?3 ORDER BY at_s",
        &range,
    )?;
    let new: Vec<Point> = readable(&rows, text(machine), "recent");
    close_one(database, machine, minute, new)?;
    database.execute(
        "DELETE FROM recent WHERE machine = ?1 AND at_s >= ?2 AND at_s < ?3",
        &range,
    )?;
    Ok(rows.len() as u64)
}

/// Closes one minute of one machine, or adds to it what came late.
fn close_one(
    database: &mut Database,
    machine: &Value,
    minute: i64,
    mut points: Vec<Point>,
) -> Result<(), StoreError> {
    let key = || [machine.clone(), minute.into()];
    let raw = database.first(
        "SELECT document FROM raw WHERE machine = ?1 AND minute = ?2",
        &key(),
    )?;
    if let Some(row) = raw {
        let before: Vec<Vec<Point>> = readable(&[row], text(machine), "raw");
        points.extend(before.into_iter().flatten());
        points.sort_by(|one, other| one.at_s.total_cmp(&other.at_s));
    }
    put(
        database,
        "raw",
        "minute",
        &key(),
        &serde_json::to_string(&points)?,
    )?;
    let Some(mean) = point::mean(&points, minute as f64 * 60.0) else {
        return Ok(());
    };
    let before = database.first(
        "SELECT document FROM minutes WHERE machine = ?1 AND minute = ?2",
        &key(),
    )?;
    let before: Option<Point> =
        before.and_then(|row| readable(&[row], text(machine), "minutes").pop());
    if before
        .as_ref()
        .is_some_and(|before| before.count > mean.count)
    {
        // Its conditions were forgotten already, and one came late: the mean of the many stays.
        return Ok(());
    }
    put(
        database,
        "minutes",
        "minute",
        &key(),
        &serde_json::to_string(&mean)?,
    )?;
    let hour = minute.div_euclid(60);
    let hour_key = [machine.clone(), hour.into()];
    let shares = if before.is_none() {
        let so_far = database.first(
            "SELECT document FROM hours WHERE machine = ?1 AND hour = ?2",
            &hour_key,
        )?;
        let so_far: Option<Point> =
            so_far.and_then(|row| readable(&[row], text(machine), "hours").pop());
        so_far.into_iter().chain([mean]).collect()
    } else {
        let rows = database.rows(
            "SELECT document FROM minutes WHERE machine = ?1 AND minute >= ?2 AND minute < ?3 ORDER BY minute",
            &[machine.clone(), (hour * 60).into(), (hour * 60 + 60).into()],
        )?;
        readable(&rows, text(machine), "minutes")
    };
    if let Some(of_hour) = point::mean(&shares, hour as f64 * 3600.0) {
        put(
            database,
            "hours",
            "hour",
            &hour_key,
            &serde_json::to_string(&of_hour)?,
        )?;
    }
    Ok(())
}

/// The documents of rows. One that cannot be read is told and left out: the history of a machine, and that of every other, goes on
/// without it.
fn readable<T: serde::de::DeserializeOwned>(rows: &[Row], machine: &str, table: &str) -> Vec<T> {
    let read = |row: &Row| match row.json(0) {
        Ok(document) => Some(document),
        Err(error) => {
            tracing::warn!("{machine}: a row of the table {table} is left out: {error}");
            None
        }
    };
    rows.iter().filter_map(read).collect()
}

/// The name of a machine, to be told.
fn text(machine: &Value) -> &str {
    match machine {
        Value::Text(name) => name,
        _ => "a machine",
    }
}

fn put(
    database: &mut Database,
    table: &str,
    column: &str,
    key: &[Value; 2],
    document: &str,
) -> Result<(), StoreError> {
    let [machine, place] = key.clone();
    database.execute(
        &format!(
            "INSERT INTO {table} (machine, {column}, document) VALUES (?1, ?2, ?3)
             ON CONFLICT (machine, {column}) DO UPDATE SET document = excluded.document"
        ),
        &[machine, place, document.into()],
    )?;
    Ok(())
}
