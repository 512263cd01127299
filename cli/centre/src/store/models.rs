//! Models, their issued versions, and roll-outs.
//!
//! The value under the key of a machine is its newest version. Any program may store a request for a roll-out; the
//! running centre processes it and advances the roll-outs.

use std::collections::{BTreeMap, HashMap};

use rusqlite::{Connection, params};
use serde_json::json;
use volcomp_fleet::{Acknowledgement, MachineId};

use crate::{
    Error,
    clock::now_s,
    records::{Model, Version},
    rollout::{Phase, Rollout, Rules, Step, UserRequest},
    store::{
        Store, audit, document, documents, execute, first, machine,
        machines::{live_of, refuse_in_open_rollout},
        number, rows,
    },
    versions::active_version,
};

/// Newest versions. A row with an empty value means that the key is empty: the last version was withdrawn, and there
/// was none before it.
const NEWEST_VERSIONS: &str = "SELECT versions.document FROM desired JOIN versions
    ON versions.machine = desired.machine AND versions.version = desired.version
    WHERE desired.value <> ''";

#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SignedValue {
    pub machine: MachineId,
    pub version: u64,
    pub model: String,
    pub value: String,
}

impl Store {
    /// Adds a model with its text. Returns `false` if the model was already stored; then only a stated day of
    /// measurements is updated.
    pub fn add_model(&self, model: &Model, text: &str) -> Result<bool, Error> {
        let document = serde_json::to_string(model)?;
        self.write(|database| {
            let added = execute(
                database,
                "INSERT INTO models (sha256, document, text) VALUES (?1, ?2, ?3) ON CONFLICT (sha256) DO NOTHING",
                [&model.sha256, &document, text],
            )?;
            if added > 0 {
                audit::append(database, &model.by, "model.add", &model.sha256, json!(model))?;
                return Ok(true);
            }
            let known = model_of(database, &model.sha256)?;
            let has_other_day = |known: &Model| {
                !model.measured.is_empty() && known.measured != model.measured
            };
            if let Some(known) = known.filter(has_other_day) {
                let details = json!({ "before": known.measured, "measured": model.measured });
                let dated = Model {
                    measured: model.measured.clone(),
                    ..known
                };
                let sql = "UPDATE models SET document = ?2 WHERE sha256 = ?1";
                execute(database, sql, [&dated.sha256, &serde_json::to_string(&dated)?])?;
                audit::append(database, &model.by, "model.measured", &model.sha256, details)?;
            }
            Ok(false)
        })
    }

    /// The model whose checksum begins with `beginning`; `None` if no model or more than one matches.
    pub fn model(&self, beginning: &str) -> Result<Option<Model>, Error> {
        if beginning.is_empty() || !beginning.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Ok(None);
        }
        let pattern = format!("{}%", beginning.to_ascii_lowercase());
        let sql = "SELECT document FROM models WHERE sha256 LIKE ?1 LIMIT 2";
        let mut found = self.read(|database| documents(database, sql, [pattern]))?;
        Ok(found.pop().filter(|_| found.is_empty()))
    }

    pub(crate) fn model_with(&self, sha256: &str) -> Result<Option<Model>, Error> {
        self.read(|database| model_of(database, sha256))
    }

    pub(crate) fn newest_models(&self) -> Result<BTreeMap<String, Model>, Error> {
        let sql = "SELECT document FROM models WHERE sha256 IN (SELECT model FROM desired)";
        let models: Vec<Model> = self.read(|database| documents(database, sql, []))?;
        let by_checksum = models.into_iter().map(|model| (model.sha256.clone(), model));
        Ok(by_checksum.collect())
    }

    pub fn model_text(&self, sha256: &str) -> Result<Option<String>, Error> {
        self.read(|database| text_of(database, sha256))
    }

    /// Every model, the newest first.
    pub fn models(&self) -> Result<Vec<Model>, Error> {
        let sql = "SELECT document FROM models";
        let mut models: Vec<Model> = self.read(|database| documents(database, sql, []))?;
        models.sort_by(|one, other| other.added_s.total_cmp(&one.added_s));
        Ok(models)
    }

    /// Every version of a machine, the newest first.
    pub fn versions(&self, machine: &MachineId) -> Result<Vec<Version>, Error> {
        self.read(|database| versions_of(database, machine))
    }

    pub fn newest_versions(&self) -> Result<BTreeMap<MachineId, Version>, Error> {
        let versions: Vec<Version> =
            self.read(|database| documents(database, NEWEST_VERSIONS, []))?;
        let by_name = (versions.into_iter()).map(|version| (version.machine.clone(), version));
        Ok(by_name.collect())
    }

    /// Desired state of a machine: its newest signed value.
    pub fn issued(&self, machine: &MachineId) -> Result<Option<SignedValue>, Error> {
        self.read(|database| newest(database, machine))
    }

    /// Newest version of every machine, without the large signed values. The flag is `false` if the version was
    /// withdrawn and the key must be empty.
    pub fn desired_versions(&self) -> Result<HashMap<MachineId, (u64, bool)>, Error> {
        let sql = "SELECT machine, version, value <> '' FROM desired";
        let wanted = self.read(|database| {
            rows(database, sql, [], |row| Ok((machine(row, 0)?, (row.get(1)?, row.get(2)?))))
        })?;
        Ok(wanted.into_iter().collect())
    }
}

pub(crate) fn text_of(database: &Connection, sha256: &str) -> Result<Option<String>, Error> {
    let sql = "SELECT text FROM models WHERE sha256 = ?1";
    first(database, sql, [sha256], |row| Ok(row.get(0)?))
}

pub(crate) fn model_of(database: &Connection, sha256: &str) -> Result<Option<Model>, Error> {
    let sql = "SELECT document FROM models WHERE sha256 = ?1";
    document(database, sql, [sha256])
}

pub(crate) fn versions_of(
    database: &Connection,
    machine: &MachineId,
) -> Result<Vec<Version>, Error> {
    let sql = "SELECT document FROM versions WHERE machine = ?1 ORDER BY version DESC";
    documents(database, sql, [machine.as_str()])
}

pub(crate) fn newest_version(
    database: &Connection,
    machine: &MachineId,
) -> Result<Option<Version>, Error> {
    let sql = format!("{NEWEST_VERSIONS} AND desired.machine = ?1");
    document(database, &sql, [machine.as_str()])
}

pub(crate) fn newest(database: &Connection, of: &MachineId) -> Result<Option<SignedValue>, Error> {
    let sql =
        "SELECT machine, version, model, value FROM desired WHERE machine = ?1 AND value <> ''";
    first(database, sql, [of.as_str()], |row| {
        Ok(SignedValue {
            machine: machine(row, 0)?,
            version: row.get(1)?,
            model: row.get(2)?,
            value: row.get(3)?,
        })
    })
}

/// Clears the key of a machine until the next version is issued: the last version was withdrawn, and there was none before it.
pub(crate) fn clear_desired(database: &Connection, machine: &MachineId) -> Result<(), Error> {
    let name = machine.as_str();
    execute(database, "UPDATE desired SET value = '' WHERE machine = ?1", [name])?;
    audit::append(database, "centre", "version.withdraw", name, json!({}))
}

/// Maximum version accepted from a machine; it leaves room for every version that will ever be issued.
const MAX_VERSION: u64 = 1 << 52;

/// Next version of a machine: above every version issued here, and above the active version that the machine reports,
/// which another centre may have issued. Reported versions above `MAX_VERSION` are ignored.
pub(crate) fn next_version(database: &Connection, machine: &MachineId) -> Result<u64, Error> {
    let sql = "SELECT coalesce(max(version), 0) FROM versions WHERE machine = ?1";
    let issued = number(database, sql, [machine.as_str()])?;
    let reported = live_of(database, machine)?.map(|live| live.version);
    let reported = reported.filter(|version| *version <= MAX_VERSION);
    Ok(issued.max(reported.unwrap_or_default()) + 1)
}

pub(crate) fn add_version(
    database: &Connection,
    version: &Version,
    value: &str,
) -> Result<(), Error> {
    let machine = version.machine.as_str();
    execute(
        database,
        "INSERT INTO versions (machine, version, model, rollout, value_sha256, document)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
        params![
            machine,
            version.version,
            version.model,
            version.rollout,
            version.value_sha256,
            serde_json::to_string(version)?,
        ],
    )?;
    execute(
        database,
        "INSERT INTO desired (machine, version, model, value) VALUES (?1, ?2, ?3, ?4)
         ON CONFLICT (machine) DO UPDATE SET version = excluded.version, model = excluded.model, value = excluded.value",
        params![machine, version.version, version.model, value],
    )?;
    audit::append(database, &version.by, "version.issue", machine, json!(version))
}

/// Stores the outcome that a machine reports for a version. An outcome for a value that was never issued here changes
/// no version.
pub(crate) fn answer(
    database: &Connection,
    machine: &MachineId,
    at_s: f64,
    answer: &Acknowledgement,
) -> Result<(), Error> {
    // A machine may report any number.
    let version = i64::try_from(answer.version).unwrap_or(i64::MAX);
    execute(
        database,
        "INSERT INTO acknowledgements (machine, at_s, version, document) VALUES (?1, ?2, ?3, ?4)",
        params![machine.as_str(), at_s, version, serde_json::to_string(answer)?],
    )?;
    let sql = "SELECT document FROM versions WHERE machine = ?1 AND value_sha256 = ?2";
    let answered: Option<Version> =
        document(database, sql, [machine.as_str(), &answer.value_sha256])?;
    let Some(answered) = answered else {
        return Ok(());
    };
    let answered =
        Version { outcome: Some(answer.outcome.clone()), answered_s: Some(at_s), ..answered };
    change_version(database, &answered)
}

pub(crate) fn change_version(database: &Connection, version: &Version) -> Result<(), Error> {
    let document = serde_json::to_string(version)?;
    execute(
        database,
        "UPDATE versions SET document = ?3 WHERE machine = ?1 AND version = ?2",
        params![version.machine.as_str(), version.version, document],
    )?;
    Ok(())
}

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
