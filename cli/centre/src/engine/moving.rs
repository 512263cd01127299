//! Roll-outs on their way: at each look every one of them hears what was seen and answered, and what it wants done is done.

use std::collections::{BTreeMap, BTreeSet};

use rusqlite::Connection;
use volcomp_fleet::MachineId;

use super::Engine;
use crate::{
    Error,
    issue::{Order, issue, withdraw},
    records::{Model, Version},
    rollout::{Action, Event, Observation, Phase, Rollout},
    store::{Issued, machines::machine_named, rollouts},
};

/// Roll-outs that could not be moved on.
#[derive(Default)]
pub(super) struct Stuck {
    /// Why, a sentence each.
    pub(super) why: Vec<String>,
    /// The machines of those that were moved on, where it is not known which machines the others have.
    moved: Option<BTreeSet<MachineId>>,
    /// Their machines: each is in one roll-out at a time.
    machines: BTreeSet<MachineId>,
}

impl Stuck {
    /// Whether what was heard of a machine has reached no roll-out that may be its own.
    pub(super) fn holds(&self, machine: &MachineId) -> bool {
        self.machines.contains(machine)
            || (self.moved.as_ref()).is_some_and(|moved| !moved.contains(machine))
    }
}

/// Moves every roll-out on, each in one transaction with what it issues. One that cannot be moved on holds up no other.
pub(super) fn look(
    engine: &Engine,
    elapsed_s: f64,
    seen: &BTreeMap<MachineId, Observation>,
    residual_um: &BTreeMap<MachineId, f64>,
) -> Result<Stuck, Error> {
    let open = engine.store.open_rollouts()?;
    if open.is_empty() {
        return Ok(Stuck::default());
    }
    // What machines have answered is taken from the store at each look: a centre that was killed between an answer and its
    // look hears of it after its start.
    let versions = engine.store.newest_versions()?;
    // A version that was never issued here is not one of a roll-out, whatever a machine tells.
    let mut seen = seen.clone();
    for (machine, seen) in &mut seen {
        let newest = versions.get(machine).map_or(0, |version| version.version);
        if seen.version > newest {
            seen.version = 0;
        }
    }
    let looked = Looked {
        elapsed_s,
        seen,
        residual_um,
        versions,
    };
    let mut stuck = Stuck::default();
    let (mut moved, mut all_known) = (BTreeSet::new(), true);
    for id in open {
        match move_on(engine, id, &looked) {
            Ok(machines) => moved.extend(machines),
            Err(error) => {
                stuck
                    .why
                    .push(format!("Roll-out {id} cannot go on: {error}."));
                match engine.store.rollout(id) {
                    Ok(rollout) => stuck
                        .machines
                        .extend(rollout.into_iter().flat_map(machines_of)),
                    Err(_) => all_known = false,
                }
            }
        }
    }
    stuck.moved = (!all_known).then_some(moved);
    Ok(stuck)
}

/// What every roll-out sees at one look.
struct Looked<'a> {
    elapsed_s: f64,
    seen: BTreeMap<MachineId, Observation>,
    /// The last residual that was known, µm.
    residual_um: &'a BTreeMap<MachineId, f64>,
    /// The newest version of each machine.
    versions: BTreeMap<MachineId, Version>,
}

fn machines_of(rollout: Rollout) -> impl Iterator<Item = MachineId> {
    rollout.targets.into_iter().map(|target| target.machine)
}

/// Moves one roll-out on, and tells its machines.
fn move_on(
    engine: &Engine,
    id: u64,
    looked: &Looked<'_>,
) -> Result<impl Iterator<Item = MachineId> + use<>, Error> {
    let Some(rollout) = engine.store.rollout(id)? else {
        return Ok(None.into_iter().flat_map(machines_of));
    };
    let model = engine.store.model(&rollout.model)?;
    let text = engine.store.model_text(&rollout.model)?;
    let material = Material {
        engine,
        model: model.as_ref().zip(text.as_deref()),
        residual_um: looked.residual_um,
    };
    engine.store.write(|database| {
        let Some((mut rollout, wishes)) = rollouts::take(database, id)? else {
            return Ok(());
        };
        let before = rollout.clone();
        let wished = (wishes.into_iter()).map(|(wish, by)| Event::Wished { wish, by });
        let answered = answers(&rollout, &looked.versions);
        let heard = Event::Looked {
            elapsed_s: looked.elapsed_s,
            seen: looked.seen.clone(),
        };
        for event in wished.chain(answered).chain([heard]) {
            let actions = rollout.step(event);
            material.act(database, &mut rollout, actions)?;
        }
        if rollout == before {
            return Ok(());
        }
        rollouts::save(database, &rollout, &before.phase)
    })?;
    Ok(Some(rollout).into_iter().flat_map(machines_of))
}

/// The answers that a roll-out has not heard of yet.
fn answers(rollout: &Rollout, versions: &BTreeMap<MachineId, Version>) -> Vec<Event> {
    let answered = rollout.targets.iter().filter_map(|target| {
        let version = versions.get(&target.machine)?;
        // What was sent meanwhile with the model of before says nothing of this one.
        let is_of_it = version.rollout.is_none_or(|id| id == rollout.id);
        let outcome = version.outcome.clone()?;
        (is_of_it && target.step.waits_for(version.version, &outcome)).then(|| Event::Answered {
            machine: target.machine.clone(),
            version: version.version,
            outcome,
        })
    });
    answered.collect()
}

/// What a manifest of a roll-out is made of.
struct Material<'a> {
    engine: &'a Engine,
    model: Option<(&'a Model, &'a str)>,
    residual_um: &'a BTreeMap<MachineId, f64>,
}

impl Material<'_> {
    fn act(
        &self,
        database: &Connection,
        rollout: &mut Rollout,
        mut actions: Vec<Action>,
    ) -> Result<(), Error> {
        // Each issue is told to the roll-out at once; what that brings up is done, too.
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
                // One of those before may have stopped it.
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
                    Err(other) => Event::NotIssued {
                        machine,
                        why: other.to_string(),
                    },
                };
                more.extend(rollout.step(event));
            }
            // A step after one of many that were issued names the others again.
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
    ) -> Result<Issued, Error> {
        // As it stands in this transaction: it may have been disabled since the look began.
        let machine = machine_named(database, name)?;
        let machine = machine.ok_or_else(|| Error::missing("machine", name))?;
        let (model, text) = self
            .model
            .ok_or_else(|| Error::missing("model", &rollout.model))?;
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
