use std::collections::BTreeMap;

use rusqlite::Connection;
use serde_json::json;
use volcomp_fleet::MachineId;

use crate::{
    Error,
    records::{Live, Machine},
    rollout::Rollout,
    store::{Store, audit, document, documents, execute},
};

pub(crate) fn machine_named(
    database: &Connection,
    machine: &MachineId,
) -> Result<Option<Machine>, Error> {
    let sql = "SELECT document FROM machines WHERE machine = ?1";
    document(database, sql, [machine.as_str()])
}

/// Fails if one of these machines is in an open roll-out.
pub(super) fn refuse_in_open_rollout<'a>(
    database: &Connection,
    machines: impl IntoIterator<Item = &'a MachineId>,
) -> Result<(), Error> {
    let sql = "SELECT state FROM rollouts WHERE finished = 0";
    let open: Vec<Rollout> = documents(database, sql, [])?;
    for machine in machines {
        let has_machine =
            |open: &&Rollout| (open.targets.iter()).any(|target| target.machine == *machine);
        if let Some(other) = open.iter().find(has_machine) {
            return Err(Error::Conflict(format!(
                "{machine} is in roll-out {}, which is not over: wait until it is done, or abort it first",
                other.id
            )));
        }
    }
    Ok(())
}

/// Registers a machine or changes its record.
///
/// # Errors
/// The serial number changes while the machine is in an open roll-out: the model was not measured on the machine with
/// the new number.
fn put(database: &Connection, machine: &Machine, by: &str) -> Result<(), Error> {
    let id = &machine.identity.machine;
    let before = machine_named(database, id)?;
    if before.is_none_or(|before| before.serial != machine.serial) {
        refuse_in_open_rollout(database, [id])?;
    }
    let name = id.as_str();
    let site = machine.identity.site.as_str();
    execute(
        database,
        "INSERT INTO machines (machine, site, document) VALUES (?1, ?2, ?3)
         ON CONFLICT (machine) DO UPDATE SET site = excluded.site, document = excluded.document",
        [name, site, &serde_json::to_string(machine)?],
    )?;
    audit::append(database, by, "machine.put", name, json!(machine))
}

pub(crate) fn live_of(database: &Connection, machine: &MachineId) -> Result<Option<Live>, Error> {
    let sql = "SELECT document FROM live WHERE machine = ?1";
    document(database, sql, [machine.as_str()])
}

pub(crate) fn put_live(database: &Connection, live: &Live) -> Result<(), Error> {
    execute(
        database,
        "INSERT INTO live (machine, document) VALUES (?1, ?2)
         ON CONFLICT (machine) DO UPDATE SET document = excluded.document",
        [live.machine.as_str(), &serde_json::to_string(live)?],
    )?;
    Ok(())
}

impl Store {
    pub fn put_machine(&self, machine: &Machine, by: &str) -> Result<(), Error> {
        self.write(|database| put(database, machine, by))
    }

    /// Changes a machine's record within a transaction, so that concurrent changes are preserved.
    pub fn change_machine(
        &self,
        machine: &MachineId,
        by: &str,
        change: impl FnOnce(Option<Machine>) -> Result<Machine, Error>,
    ) -> Result<Machine, Error> {
        self.write(|database| {
            let changed = change(machine_named(database, machine)?)?;
            put(database, &changed, by)?;
            Ok(changed)
        })
    }

    pub fn machine(&self, machine: &MachineId) -> Result<Option<Machine>, Error> {
        self.read(|database| machine_named(database, machine))
    }

    /// Every machine, sorted by name.
    pub fn machines(&self) -> Result<Vec<Machine>, Error> {
        let sql = "SELECT document FROM machines ORDER BY machine";
        self.read(|database| documents(database, sql, []))
    }

    /// Removes a machine but keeps its versions and history. Returns `false` if the machine did not exist.
    pub fn remove_machine(&self, machine: &MachineId, by: &str) -> Result<bool, Error> {
        self.write(|database| {
            let name = [machine.as_str()];
            let is_there = execute(database, "DELETE FROM machines WHERE machine = ?1", name)? > 0;
            execute(database, "DELETE FROM live WHERE machine = ?1", name)?;
            if is_there {
                audit::append(database, by, "machine.remove", machine.as_str(), json!({}))?;
            }
            Ok(is_there)
        })
    }

    pub fn live(&self) -> Result<BTreeMap<MachineId, Live>, Error> {
        let lives: Vec<Live> =
            self.read(|database| documents(database, "SELECT document FROM live", []))?;
        let by_name = lives.into_iter().map(|live| (live.machine.clone(), live));
        Ok(by_name.collect())
    }

    pub fn live_of(&self, machine: &MachineId) -> Result<Option<Live>, Error> {
        self.read(|database| live_of(database, machine))
    }

    /// Stores last states of machines, all or none. For other programs than the running centre, which stores these
    /// states itself.
    pub fn put_live(&self, lives: &[Live]) -> Result<(), Error> {
        self.write(|database| lives.iter().try_for_each(|live| put_live(database, live)))
    }
}
