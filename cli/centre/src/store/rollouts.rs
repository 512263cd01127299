//! Roll-outs in the store. The program that runs the centre moves them on; any program may write a wish, which that one
//! takes up.

use serde_json::json;
use volcomp_fleet::MachineId;

use super::{
    Store, StoreError, audit,
    database::Database,
    models::{live_of, versions_of},
};
use crate::{
    drift::in_force,
    rollout::{Phase, Rollout, Step, Wish},
};

impl Store {
    /// Starts a roll-out: `make` is told its number.
    ///
    /// # Errors
    /// A machine of it has its turn in another roll-out that is not over. Or: the database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn start_rollout(&self, make: impl FnOnce(u64) -> Rollout) -> Result<Rollout, StoreError> {
        self.write(|database| {
            let row = database.first("SELECT coalesce(max(id), 0) + 1 FROM rollouts", &[])?;
            let id = row.map_or(Ok(1), |row| row.count(0))?;
            let rollout = make(id);
            for other in open(database)? {
                let shared = (rollout.targets.iter())
                    .find(|target| other.targets.iter().any(|one| one.machine == target.machine));
                if let Some(target) = shared {
                    return Err(StoreError::Rollout {
                        machine: target.machine.to_string(),
                        rollout: other.id,
                    });
                }
            }
            database.execute(
                "INSERT INTO rollouts (id, state, finished) VALUES (?1, ?2, ?3)",
                &[
                    id.into(),
                    serde_json::to_string(&rollout)?.into(),
                    rollout.phase.is_over().into(),
                ],
            )?;
            audit::append(
                database,
                &rollout.by,
                "rollout.start",
                &id.to_string(),
                json!({ "model": rollout.model, "machines": rollout.targets.len(), "rules": rollout.rules }),
            )?;
            Ok(rollout)
        })
    }

    /// A roll-out.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn rollout(&self, id: u64) -> Result<Option<Rollout>, StoreError> {
        self.read(|database| {
            let row = database.first("SELECT state FROM rollouts WHERE id = ?1", &[id.into()])?;
            row.map(|row| row.json(0)).transpose()
        })
    }

    /// The last `count` roll-outs, the newest first.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn rollouts(&self, count: u32) -> Result<Vec<Rollout>, StoreError> {
        self.read(|database| {
            let rows = database.rows(
                "SELECT state FROM rollouts ORDER BY id DESC LIMIT ?1",
                &[count.into()],
            )?;
            rows.iter().map(|row| row.json(0)).collect()
        })
    }

    /// The numbers of the roll-outs that are not over.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn open_rollouts(&self) -> Result<Vec<u64>, StoreError> {
        self.read(|database| {
            let rows = database.rows(
                "SELECT id FROM rollouts WHERE finished = 0 ORDER BY id",
                &[],
            )?;
            rows.iter().map(|row| row.count(0)).collect()
        })
    }

    /// Writes down what a person wishes of a roll-out; the running centre takes it up within a second, after those before
    /// it; one that ends the roll-out before all of them.
    ///
    /// # Errors
    /// There is no such roll-out, or it is confirmed what does not wait for a confirmation. Or: the database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn wish(&self, id: u64, wish: &Wish, by: &str) -> Result<(), StoreError> {
        self.write(|database| {
            let known = database.first("SELECT state FROM rollouts WHERE id = ?1", &[id.into()])?;
            let known = known.ok_or_else(|| missing(id))?;
            if let Wish::Confirm { machine, hash } = wish {
                // What would come of nothing is said now: whoever wishes it does not see the running centre drop it.
                let rollout: Rollout = known.json(0)?;
                let is_ending = waiting_wishes(database, id)?
                    .iter()
                    .any(|(wish, _)| *wish == Wish::Abort);
                rollout
                    .may_confirm(machine, hash, is_ending)
                    .map_err(|why| StoreError::NotConfirmed { why })?;
            }
            let row = database.first(
                "SELECT coalesce(max(number), 0) + 1 FROM wishes WHERE rollout = ?1",
                &[id.into()],
            )?;
            let number = row.map_or(Ok(1), |row| row.count(0))?;
            let text = serde_json::to_string(&(wish, by))?;
            database.execute(
                "INSERT INTO wishes (rollout, number, document) VALUES (?1, ?2, ?3)",
                &[id.into(), number.into(), text.into()],
            )?;
            audit::append(database, by, "rollout.wish", &id.to_string(), json!(wish))
        })
    }
}

impl Store {
    /// Writes down that a machine keeps the model of a roll-out that is broken off.
    ///
    /// # Errors
    /// There is no such roll-out with such a machine, or it goes on or is done, or the machine does not have its model. Or: the database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn keep_model(&self, id: u64, machine: &MachineId, by: &str) -> Result<(), StoreError> {
        self.write(|database| {
            let row = database.first("SELECT state FROM rollouts WHERE id = ?1", &[id.into()])?;
            let mut rollout: Rollout = match row {
                Some(row) => row.json(0)?,
                None => return Err(missing(id)),
            };
            if !rollout.phase.is_broken_off() {
                return Err(StoreError::NotBrokenOff { rollout: id });
            }
            let mut targets = rollout.targets.iter_mut();
            let target = targets.find(|target| target.machine == *machine);
            let target = target.ok_or_else(|| StoreError::Missing {
                what: "machine of that roll-out",
                name: machine.to_string(),
            })?;
            let versions = versions_of(database, machine)?;
            let has = in_force(&versions, live_of(database, machine)?.as_ref());
            // Where nothing else is known, what the roll-out has seen of it counts.
            let seen = matches!(target.step, Step::Done { .. } | Step::Soaking { .. });
            if !has.map_or(seen, |version| version.rollout == Some(id)) {
                return Err(StoreError::NotInForce {
                    machine: machine.to_string(),
                    rollout: id,
                });
            }
            target.kept_by = Some(by.to_owned());
            let phase = rollout.phase.clone();
            save(database, &rollout, &phase)?;
            audit::append(
                database,
                by,
                "rollout.keep",
                &id.to_string(),
                json!({ "machine": machine }),
            )
        })
    }
}

fn missing(id: u64) -> StoreError {
    StoreError::Missing {
        what: "roll-out",
        name: id.to_string(),
    }
}

fn open(database: &mut Database) -> Result<Vec<Rollout>, StoreError> {
    let rows = database.rows("SELECT state FROM rollouts WHERE finished = 0", &[])?;
    rows.iter().map(|row| row.json(0)).collect()
}

/// A wish and who has it.
type Wished = (Wish, String);

/// The wishes of a roll-out that wait for the running centre, in their order.
fn waiting_wishes(database: &mut Database, id: u64) -> Result<Vec<Wished>, StoreError> {
    let rows = database.rows(
        "SELECT document FROM wishes WHERE rollout = ?1 ORDER BY number",
        &[id.into()],
    )?;
    rows.iter().map(|row| row.json(0)).collect()
}

/// A roll-out with the wishes that wait, in their order, which are taken. Where one of them ends it, the others are not done.
pub(crate) fn take(
    database: &mut Database,
    id: u64,
) -> Result<Option<(Rollout, Vec<Wished>)>, StoreError> {
    let row = database.first("SELECT state FROM rollouts WHERE id = ?1", &[id.into()])?;
    let Some(row) = row else { return Ok(None) };
    let rollout = row.json(0)?;
    let mut wishes = waiting_wishes(database, id)?;
    if wishes.is_empty() {
        return Ok(Some((rollout, wishes)));
    }
    if let Some(end) = wishes.iter().position(|(wish, _)| *wish == Wish::Abort) {
        wishes = vec![wishes.swap_remove(end)];
    }
    database.execute("DELETE FROM wishes WHERE rollout = ?1", &[id.into()])?;
    Ok(Some((rollout, wishes)))
}

/// Stores where a roll-out stands. A change of its phase is written into the audit log.
pub(crate) fn save(
    database: &mut Database,
    rollout: &Rollout,
    before: &Phase,
) -> Result<(), StoreError> {
    database.execute(
        "UPDATE rollouts SET state = ?2, finished = ?3 WHERE id = ?1",
        &[
            rollout.id.into(),
            serde_json::to_string(rollout)?.into(),
            rollout.phase.is_over().into(),
        ],
    )?;
    if *before != rollout.phase {
        audit::append(
            database,
            "centre",
            "rollout.phase",
            &rollout.id.to_string(),
            json!(rollout.phase),
        )?;
    }
    Ok(())
}
