//! Roll-outs in the store. Any program may store a request; the running centre processes it and advances the roll-outs.

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
    rollout::{Phase, Rollout, Rules, Step, UserRequest},
    versions::active_version,
};

impl Store {
    /// Starts a roll-out of a model. `machines` states for each machine whether it is a canary.
    pub fn begin_rollout(
        &self,
        sha256: &str,
        machines: &[(MachineId, bool)],
        rules: Rules,
        by: &str,
    ) -> Result<Rollout, Error> {
        self.start_rollout(|id| Rollout::new(id, sha256, machines, rules, by, now_s()))
    }

    /// Starts a roll-out that `make` creates from its number.
    ///
    /// # Errors
    /// A machine of the roll-out is in another open roll-out.
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

    pub fn open_rollouts(&self) -> Result<Vec<u64>, Error> {
        let sql = "SELECT id FROM rollouts WHERE finished = 0 ORDER BY id";
        self.read(|database| rows(database, sql, [], |row| Ok(row.get(0)?)))
    }

    /// Stores a user's request for a roll-out. The running centre processes it within a second, after earlier requests; an abort precedes all
    /// others.
    ///
    /// # Errors
    /// The roll-out does not exist, or the confirmed change does not wait for a confirmation.
    pub fn request_rollout_change(
        &self,
        id: u64,
        request: &UserRequest,
        by: &str,
    ) -> Result<(), Error> {
        self.write(|database| {
            let rollout = rollout(database, id)?.ok_or_else(|| Error::missing("roll-out", &id))?;
            if let UserRequest::Confirm { machine, hash } = request {
                // Reject requests without effect now: the user would not see that the running centre discards them.
                let waiting = pending_requests(database, id)?;
                let is_ending = waiting.iter().any(|(request, _)| *request == UserRequest::Abort);
                let checked = rollout.may_confirm(machine, hash, is_ending);
                checked.map_err(Error::NotConfirmed)?;
            }
            execute(
                database,
                "INSERT INTO wishes (rollout, number, document)
                 SELECT ?1, coalesce(max(number), 0) + 1, ?2 FROM wishes WHERE rollout = ?1",
                params![id, serde_json::to_string(&(request, by))?],
            )?;
            audit::append(database, by, "rollout.wish", &id.to_string(), json!(request))
        })
    }

    /// Records that a machine keeps the model of a stopped or aborted roll-out.
    ///
    /// # Errors
    /// The roll-out or its machine does not exist, the roll-out is active or done, or its model is not active on the
    /// machine.
    pub fn keep_model(&self, id: u64, machine: &MachineId, by: &str) -> Result<(), Error> {
        self.write(|database| {
            let mut rollout = rollout(database, id)?.ok_or_else(|| Error::missing("roll-out", &id))?;
            if !rollout.phase.is_broken_off() {
                return Err(Error::Conflict(format!(
                    "roll-out {id} is running or done: expected a stopped or aborted one"
                )));
            }
            let mut targets = rollout.targets.iter_mut();
            let target = targets.find(|target| target.machine == *machine);
            let target =
                target.ok_or_else(|| Error::missing("machine of that roll-out", machine))?;
            let versions = versions_of(database, machine)?;
            let has = active_version(&versions, live_of(database, machine)?.as_ref());
            // If the active version is unknown, use the step of the target.
            let seen = matches!(target.step, Step::Done { .. } | Step::Soaking { .. });
            if !has.map_or(seen, |version| version.rollout == Some(id)) {
                return Err(Error::Conflict(format!(
                    "the model of roll-out {id} is not active on {machine}: expected a machine that corrects with it"
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

type RequestBy = (UserRequest, String);

/// Pending requests of a roll-out, the oldest first.
fn pending_requests(database: &Connection, id: u64) -> Result<Vec<RequestBy>, Error> {
    let sql = "SELECT document FROM wishes WHERE rollout = ?1 ORDER BY number";
    documents(database, sql, [id])
}

/// Returns a roll-out with its pending requests in order, and removes the requests from the store. An abort discards
/// all other requests.
pub(crate) fn take(
    database: &Connection,
    id: u64,
) -> Result<Option<(Rollout, Vec<RequestBy>)>, Error> {
    let Some(rollout) = rollout(database, id)? else {
        return Ok(None);
    };
    let mut requests = pending_requests(database, id)?;
    if requests.is_empty() {
        return Ok(Some((rollout, requests)));
    }
    if let Some(end) = requests.iter().position(|(request, _)| *request == UserRequest::Abort) {
        requests = vec![requests.swap_remove(end)];
    }
    execute(database, "DELETE FROM wishes WHERE rollout = ?1", [id])?;
    Ok(Some((rollout, requests)))
}

/// Stores the state of a roll-out. A change of its phase is written to the audit log.
pub(crate) fn save(database: &Connection, rollout: &Rollout, before: &Phase) -> Result<(), Error> {
    let Rollout { id, phase, .. } = rollout;
    execute(
        database,
        "UPDATE rollouts SET state = ?2, finished = ?3 WHERE id = ?1",
        params![id, serde_json::to_string(rollout)?, phase.is_over()],
    )?;
    if before != phase {
        audit::append(database, "centre", "rollout.phase", &id.to_string(), json!(phase))?;
    }
    Ok(())
}
