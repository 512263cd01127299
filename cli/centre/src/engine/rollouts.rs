//! Active roll-outs: each pass feeds every roll-out with observations and outcomes, and executes its actions.

use std::collections::{BTreeMap, BTreeSet};

use rusqlite::Connection;
use volcomp_fleet::MachineId;

use super::Engine;
use crate::{
    Error,
    issue::{Order, issue, withdraw},
    records::{Model, Version},
    rollout::{Action, Event, Observation, Phase, Rollout},
    store::{SignedValue, machines::machine_named, rollouts as stored},
};

/// Roll-outs that could not be advanced.
#[derive(Default)]
pub(super) struct Blocked {
    /// The reasons, one sentence each.
    pub(super) why: Vec<String>,
    /// Machines of the roll-outs that were advanced, if a blocked roll-out could not be read, so that its machines are
    /// unknown; otherwise `None`.
    moved: Option<BTreeSet<MachineId>>,
    /// Machines of the blocked roll-outs; each machine is in at most one open roll-out.
    machines: BTreeSet<MachineId>,
}

impl Blocked {
    /// True if the roll-out of a machine may not have processed the machine's reports.
    pub(super) fn holds(&self, machine: &MachineId) -> bool {
        self.machines.contains(machine)
            || (self.moved.as_ref()).is_some_and(|moved| !moved.contains(machine))
    }
}

/// Advances every roll-out in its own transaction together with the manifests it issues. A roll-out that fails does not block the others.
pub(super) fn advance_all(
    engine: &Engine,
    elapsed_s: f64,
    seen: &BTreeMap<MachineId, Observation>,
    residual_um: &BTreeMap<MachineId, f64>,
) -> Result<Blocked, Error> {
    let open = engine.store.open_rollouts()?;
    if open.is_empty() {
        return Ok(Blocked::default());
    }
    // Each pass reads the outcomes from the store, so a centre that was killed before evaluating them does so after its
    // restart.
    let versions = engine.store.newest_versions()?;
    // A version that was never issued here belongs to no roll-out, even if a machine reports it.
    let mut seen = seen.clone();
    for (machine, seen) in &mut seen {
        let newest = versions.get(machine).map_or(0, |version| version.version);
        if seen.version > newest {
            seen.version = 0;
        }
    }
    let input = PassInput { elapsed_s, seen, residual_um, versions };
    let mut blocked = Blocked::default();
    let (mut moved, mut all_known) = (BTreeSet::new(), true);
    for id in open {
        match advance(engine, id, &input) {
            Ok(machines) => moved.extend(machines),
            Err(error) => {
                blocked.why.push(format!("Roll-out {id} cannot proceed: {error}."));
                match engine.store.rollout(id) {
                    Ok(rollout) => {
                        blocked.machines.extend(rollout.into_iter().flat_map(machines_of));
                    }
                    Err(_) => all_known = false,
                }
            }
        }
    }
    blocked.moved = (!all_known).then_some(moved);
    Ok(blocked)
}

struct PassInput<'a> {
    elapsed_s: f64,
    seen: BTreeMap<MachineId, Observation>,
    residual_um: &'a BTreeMap<MachineId, f64>,
    versions: BTreeMap<MachineId, Version>,
}

fn machines_of(rollout: Rollout) -> impl Iterator<Item = MachineId> {
    rollout.targets.into_iter().map(|target| target.machine)
}

fn advance(
    engine: &Engine,
    id: u64,
    input: &PassInput<'_>,
) -> Result<impl Iterator<Item = MachineId> + use<>, Error> {
    let Some(rollout) = engine.store.rollout(id)? else {
        return Ok(None.into_iter().flat_map(machines_of));
    };
    let model = engine.store.model(&rollout.model)?;
    let text = engine.store.model_text(&rollout.model)?;
    // If the database is an older copy, a machine may have another model under the same version.
    let mut seen = input.seen.clone();
    if let Some(model) = &model {
        for other in seen.values_mut().filter(|seen| seen.model != model.checksum) {
            other.version = 0;
        }
    }
    let source = ManifestSource {
        engine,
        model: model.as_ref().zip(text.as_deref()),
        residual_um: input.residual_um,
    };
    engine.store.write(|database| {
        let Some((mut rollout, requests)) = stored::take(database, id)? else {
            return Ok(());
        };
        let before = rollout.clone();
        let wished = (requests.into_iter()).map(|(request, by)| Event::Requested { request, by });
        let answered = answers(&rollout, &input.versions);
        let heard = Event::Pass { elapsed_s: input.elapsed_s, seen };
        for event in wished.chain(answered).chain([heard]) {
            let actions = rollout.step(event);
            source.execute(database, &mut rollout, actions)?;
        }
        if rollout == before {
            return Ok(());
        }
        stored::save(database, &rollout, &before.phase)
    })?;
    Ok(Some(rollout).into_iter().flat_map(machines_of))
}

/// Outcomes that the roll-out has not processed yet.
fn answers(rollout: &Rollout, versions: &BTreeMap<MachineId, Version>) -> Vec<Event> {
    let answered = rollout.targets.iter().filter_map(|target| {
        let version = versions.get(&target.machine)?;
        // The outcome of a later manifest with the previous model does not apply to this roll-out's model.
        let is_of_rollout = version.rollout.is_none_or(|id| id == rollout.id);
        let outcome = version.outcome.clone()?;
        (is_of_rollout && target.step.is_new_outcome(version.version, &outcome)).then(|| {
            Event::Answered { machine: target.machine.clone(), version: version.version, outcome }
        })
    });
    answered.collect()
}

struct ManifestSource<'a> {
    engine: &'a Engine,
    model: Option<(&'a Model, &'a str)>,
    residual_um: &'a BTreeMap<MachineId, f64>,
}

impl ManifestSource<'_> {
    fn execute(
        &self,
        database: &Connection,
        rollout: &mut Rollout,
        mut actions: Vec<Action>,
    ) -> Result<(), Error> {
        // The roll-out receives the result of each issue immediately, and the resulting actions are executed in the
        // next iteration.
        while !actions.is_empty() {
            let mut more = Vec::new();
            for action in actions {
                let (machine, confirm) = match action {
                    Action::Issue { machine, confirm } => (machine, confirm),
                    Action::Withdraw { machine } => {
                        withdraw(database, &self.engine.settings.key, &machine, rollout.id)?;
                        continue;
                    }
                };
                // An earlier action may have stopped the roll-out.
                if confirm.is_none() && rollout.phase != Phase::Running {
                    continue;
                }
                let event = match self.issue(database, rollout, &machine, confirm) {
                    Ok(issued) => Event::Issued {
                        before_um: self.residual_um.get(&machine).copied(),
                        version: issued.version,
                        machine,
                    },
                    Err(error) if error.is_of_database() => return Err(error),
                    Err(other) => Event::NotIssued { machine, why: other.to_string() },
                };
                more.extend(rollout.step(event));
            }
            // The roll-out repeats the pending actions of other machines at each step.
            more.retain(|action| match action {
                Action::Issue { machine, .. } => rollout.is_waiting(machine),
                Action::Withdraw { .. } => true,
            });
            more.dedup();
            actions = more;
        }
        Ok(())
    }

    fn issue(
        &self,
        database: &Connection,
        rollout: &Rollout,
        name: &MachineId,
        confirm: Option<String>,
    ) -> Result<SignedValue, Error> {
        // Read in this transaction: the machine may have been disabled since the pass began.
        let machine = machine_named(database, name)?;
        let machine = machine.ok_or_else(|| Error::missing("machine", name))?;
        let (model, text) = self.model.ok_or_else(|| Error::missing("model", &rollout.model))?;
        let order = Order {
            machine: &machine,
            model,
            text,
            confirm,
            rollout: Some(rollout.id),
            by: &rollout.by,
        };
        issue(database, &self.engine.settings.key, &order)
    }
}
