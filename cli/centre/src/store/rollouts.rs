//! Roll-outs in the store. The program that runs the centre moves them on; any program may write a wish, which that one
//! takes up.

use rusqlite::{Connection, params};
use serde_json::json;
use volcomp_fleet::MachineId;

use super::{
    Store, audit,
    database::{document, documents, execute, number, rows},
    machines::{live_of, refuse_in_open_rollout},
    models::versions_of,
};
use crate::{
    Error,
    clock::now_s,
    rollout::{Phase, Rollout, Rules, Step, Wish},
    versions::in_force,
};

impl Store {
    /// Starts a roll-out of a model to machines, each with whether it is a canary.
    pub fn begin_rollout(
        &self,
        sha256: &str,
        machines: &[(MachineId, bool)],
        rules: Rules,
        by: &str,
    ) -> Result<Rollout, Error> {
        self.start_rollout(|id| Rollout::new(id, sha256, machines, rules, by, now_s()))
    }

    /// Starts a roll-out: `make` makes it with its number.
    ///
    /// # Errors
    /// A machine of it has its turn in another roll-out that is not over.
    pub fn start_rollout(&self, make: impl FnOnce(u64) -> Rollout) -> Result<Rollout, Error> {
        self.write(|database| {
            let id = number(database, "SELECT coalesce(max(id), 0) + 1 FROM rollouts", [])?;
            let rollout = make(id);
            let machines = rollout.targets.iter().map(|target| &target.machine);
            refuse_in_open_rollout(database, machines)?;
            execute(
                database,
                "INSERT INTO rollouts (id, state, finished) VALUES (?1, ?2, ?3)",
                params![id, serde_json::to_string(&rollout)?, rollout.phase.is_over()],
            )?;
            let details = json!({ "model": rollout.model, "machines": rollout.targets.len(), "rules": rollout.rules });
            audit::append(database, &rollout.by, "rollout.start", &id.to_string(), details)?;
            Ok(rollout)
        })
    }

    pub fn rollout(&self, id: u64) -> Result<Option<Rollout>, Error> {
        self.read(|database| rollout(database, id))
    }

    /// The last `count` roll-outs, the newest first.
    pub fn rollouts(&self, count: u32) -> Result<Vec<Rollout>, Error> {
        let sql = "SELECT state FROM rollouts ORDER BY id DESC LIMIT ?1";
        self.read(|database| documents(database, sql, [count]))
    }

    /// The numbers of the roll-outs that are not over.
    pub fn open_rollouts(&self) -> Result<Vec<u64>, Error> {
        let sql = "SELECT id FROM rollouts WHERE finished = 0 ORDER BY id";
        self.read(|database| rows(database, sql, [], |row| Ok(row.get(0)?)))
    }

    /// Writes down what a person wishes of a roll-out; the running centre takes it up within a second, after those before
    /// it; one that ends the roll-out before all of them.
    ///
    /// # Errors
    /// There is no such roll-out, or it is confirmed what does not wait for a confirmation.
    pub fn wish(&self, id: u64, wish: &Wish, by: &str) -> Result<(), Error> {
        self.write(|database| {
            let rollout = rollout(database, id)?.ok_or_else(|| Error::missing("roll-out", &id))?;
            if let Wish::Confirm { machine, hash } = wish {
                // What would come of nothing is refused now: whoever wishes it does not see the running centre drop it.
                let waiting = waiting_wishes(database, id)?;
                let is_ending = waiting.iter().any(|(wish, _)| *wish == Wish::Abort);
                let checked = rollout.may_confirm(machine, hash, is_ending);
                checked.map_err(Error::NotConfirmed)?;
            }
            execute(
                database,
                "INSERT INTO wishes (rollout, number, document)
                 SELECT ?1, coalesce(max(number), 0) + 1, ?2 FROM wishes WHERE rollout = ?1",
                params![id, serde_json::to_string(&(wish, by))?],
            )?;
            audit::append(database, by, "rollout.wish", &id.to_string(), json!(wish))
        })
    }

    /// Writes down that a machine keeps the model of a roll-out that is broken off.
    ///
    /// # Errors
    /// There is no such roll-out with such a machine, or it goes on or is done, or the machine does not have its model.
    pub fn keep_model(&self, id: u64, machine: &MachineId, by: &str) -> Result<(), Error> {
        self.write(|database| {
            let mut rollout = rollout(database, id)?.ok_or_else(|| Error::missing("roll-out", &id))?;
            if !rollout.phase.is_broken_off() {
                return Err(Error::Conflict(format!(
                    "roll-out {id} goes on or is done: expected one that has stopped or was ended before it was done"
                )));
            }
            let mut targets = rollout.targets.iter_mut();
            let target = targets.find(|target| target.machine == *machine);
            let target =
                target.ok_or_else(|| Error::missing("machine of that roll-out", machine))?;
            let versions = versions_of(database, machine)?;
            let has = in_force(&versions, live_of(database, machine)?.as_ref());
            // Where nothing else is known, what the roll-out has seen of it counts.
            let seen = matches!(target.step, Step::Done { .. } | Step::Soaking { .. });
            if !has.map_or(seen, |version| version.rollout == Some(id)) {
                return Err(Error::Conflict(format!(
                    "{machine} does not have the model of roll-out {id} in force: expected a machine that corrects with it"
                )));
            }
            target.kept_by = Some(by.to_owned());
            let phase = rollout.phase.clone();
            save(database, &rollout, &phase)?;
            let details = json!({ "machine": machine });
            audit::append(database, by, "rollout.keep", &id.to_string(), details)
        })
    }
}

fn rollout(database: &Connection, id: u64) -> Result<Option<Rollout>, Error> {
    document(database, "SELECT state FROM rollouts WHERE id = ?1", [id])
}

/// A wish and who has it.
type WishBy = (Wish, String);

/// The wishes of a roll-out that wait for the running centre, in their order.
fn waiting_wishes(database: &Connection, id: u64) -> Result<Vec<WishBy>, Error> {
    let sql = "SELECT document FROM wishes WHERE rollout = ?1 ORDER BY number";
    documents(database, sql, [id])
}

/// A roll-out with the wishes that wait, in their order, which are taken. Where one of them ends it, the others are not done.
pub(crate) fn take(
    database: &Connection,
    id: u64,
) -> Result<Option<(Rollout, Vec<WishBy>)>, Error> {
    let Some(rollout) = rollout(database, id)? else {
        return Ok(None);
    };
    let mut wishes = waiting_wishes(database, id)?;
    if wishes.is_empty() {
        return Ok(Some((rollout, wishes)));
    }
    if let Some(end) = wishes.iter().position(|(wish, _)| *wish == Wish::Abort) {
        wishes = vec![wishes.swap_remove(end)];
    }
    execute(database, "DELETE FROM wishes WHERE rollout = ?1", [id])?;
    Ok(Some((rollout, wishes)))
}

/// Stores where a roll-out stands. A change of its phase is written into the audit log.
pub(crate) fn save(database: &Connection, rollout: &Rollout, before: &Phase) -> Result<(), Error> {
    let Rollout { id, phase, .. } = rollout;
    execute(
        database,
        "UPDATE rollouts SET state = ?2, finished = ?3 WHERE id = ?1",
        params![id, serde_json::to_string(rollout)?, phase.is_over()],
    )?;
    if before != phase {
        audit::append(
            database,
            "centre",
            "rollout.phase",
            &id.to_string(),
            json!(phase),
        )?;
    }
    Ok(())
}
