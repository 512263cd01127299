//! One look: roll-outs go on, alarms are raised and closed, the history is put in order. Everything here waits for the disk.

use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::{Duration, Instant},
};

use volcomp_fleet::{MachineId, SiteId};

use super::{Engine, alarms, blocking, writer::lock};
use crate::{
    clock::now_s,
    drift::in_force,
    ingest::Since,
    issue::{NotIssued, Order, differs, issue, missing, settle, withdraw},
    records::{AlarmKind, Machine, Model, Version},
    rollout::{Action, Event, Phase, Rollout, Seen},
    store::{Database, Issued, StoreError, machines::machine_named, rollouts},
};

/// Minutes are closed so often, …
const MINUTE: Duration = Duration::from_secs(60);
/// … and when they ended so long ago, s: most of what was under way has come.
const CLOSED_AFTER_S: f64 = 30.0;
/// So many machines are told other settings at one look.
const SETTINGS: usize = 200;
/// What is no longer kept is forgotten so often.
const HOUR: Duration = Duration::from_secs(3600);

/// What is held from look to look.
pub(super) struct State {
    last: Instant,
    minute: Instant,
    hour: Option<Instant>,
    /// The last residual that was known of each machine, µm: conditions may be rarer than looks.
    residual_um: BTreeMap<MachineId, f64>,
    /// Machines whose settings cannot be sent, and why.
    unsettled: BTreeMap<MachineId, String>,
    pub(super) alarms: alarms::Open,
}

impl State {
    pub(super) fn new() -> Self {
        let now = Instant::now();
        Self {
            last: now,
            minute: now,
            hour: None,
            residual_um: BTreeMap::new(),
            unsettled: BTreeMap::new(),
            alarms: alarms::Open::default(),
        }
    }
}

/// The sites of the machines that are registered.
pub(super) async fn sites(engine: &Arc<Engine>) -> BTreeSet<SiteId> {
    let of_store = Arc::clone(engine);
    let machines = blocking(move || of_store.store.machines()).await;
    let machines = machines.unwrap_or_default();
    machines
        .into_iter()
        .map(|machine| machine.identity.site)
        .collect()
}

/// Looks once. Trouble with the database is told, and the next look tries again.
pub(super) async fn look(engine: &Arc<Engine>, state: State) -> State {
    let engine = Arc::clone(engine);
    blocking(move || {
        let mut state = state;
        if let Err(error) = look_now(&engine, &mut state) {
            engine.trouble(AlarmKind::Store, Some(error.to_string()));
        }
        state
    })
    .await
}

fn look_now(engine: &Engine, state: &mut State) -> Result<(), StoreError> {
    let now = Instant::now();
    let elapsed_s = now.duration_since(state.last).as_secs_f64();
    state.last = now;
    let machines = engine.store.machines()?;
    let looked = {
        let mut ingest = lock(&engine.ingest);
        ingest.store_live(&engine.store)?;
        let limits: BTreeMap<&MachineId, f64> = (machines.iter())
            .map(|machine| (&machine.identity.machine, machine.silent_after_s()))
            .collect();
        let looked = ingest.look(|name| limits.get(name).copied().unwrap_or(Machine::SILENT_S));
        for (machine, (seen, _)) in &looked {
            let told = || {
                ingest
                    .machine(machine)?
                    .live
                    .as_ref()?
                    .condition
                    .as_ref()?
                    .residual_um
            };
            let known = seen.residual_um.or_else(told);
            if let Some(um) = known.filter(|um| um.is_finite()) {
                state.residual_um.insert(machine.clone(), um);
            }
        }
        looked
    };
    let seen: BTreeMap<MachineId, Seen> = (looked.iter())
        .map(|(machine, (seen, _))| (machine.clone(), seen.clone()))
        .collect();
    let since: BTreeMap<MachineId, Since> = (looked.into_iter())
        .map(|(machine, (_, since))| (machine, since))
        .collect();
    let held = match roll_out(engine, elapsed_s, &seen, &state.residual_um) {
        Ok(held) => held,
        Err(error) => {
            // What was heard counts at the next look, before what came meanwhile.
            lock(&engine.ingest).put_back(since);
            return Err(error);
        }
    };
    let unseen = since.iter().filter(|(name, _)| held.holds(name));
    let unseen = unseen.map(|(name, since)| {
        // The alarms have these.
        let unreadable = 0;
        let since = Since {
            unreadable,
            ..since.clone()
        };
        (name.clone(), since)
    });
    let unseen: BTreeMap<MachineId, Since> = unseen.collect();
    lock(&engine.ingest).put_back(unseen);
    let why = (!held.why.is_empty()).then(|| held.why.join(" "));
    engine.trouble(AlarmKind::Rollout, why);
    let told = (|| {
        let versions = newest_versions(engine)?;
        settings(engine, &mut state.unsettled, &machines, &versions)?;
        alarms::look(engine, &mut state.alarms, &machines, &versions, &since)
    })();
    if let Err(error) = told {
        // The roll-outs have had their part; what the alarms have not had is told at the next look.
        let untold = since.into_iter().map(|(name, since)| {
            let untold = Since {
                unreadable: since.unreadable,
                why_unreadable: since.why_unreadable,
                ..Since::default()
            };
            (name, untold)
        });
        lock(&engine.ingest).put_back(untold.collect());
        return Err(error);
    }
    if now.duration_since(state.minute) >= MINUTE {
        state.minute = now;
        lock(&engine.ingest).count_missing();
        engine.store.close_minutes(now_s() - CLOSED_AFTER_S)?;
    }
    if state
        .hour
        .is_none_or(|hour| now.duration_since(hour) >= HOUR)
    {
        state.hour = Some(now);
        engine.store.forget(engine.settings.keep, now_s())?;
    }
    Ok(())
}

/// The newest version of each machine that has one.
fn newest_versions(engine: &Engine) -> Result<BTreeMap<MachineId, Version>, StoreError> {
    let versions = engine.store.newest_versions()?.into_iter();
    Ok(versions
        .map(|version| (version.machine.clone(), version))
        .collect())
}

/// Has every machine told what it is registered with, whoever changed that and however.
fn settings(
    engine: &Engine,
    unsettled: &mut BTreeMap<MachineId, String>,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
) -> Result<(), StoreError> {
    let before = std::mem::take(unsettled);
    let mut issued = 0;
    for machine in machines {
        let name = &machine.identity.machine;
        if issued == SETTINGS {
            break;
        }
        let is_other = if let Some(newest) = versions.get(name) {
            differs(machine, newest)
        } else {
            // Where nothing is under its key it goes on with what it has.
            let live = lock(&engine.ingest)
                .machine(name)
                .and_then(|heard| heard.live.clone());
            match live.filter(|live| live.version > 0) {
                Some(live) => {
                    let versions = engine.store.versions(name)?;
                    in_force(&versions, Some(&live)).is_some_and(|one| differs(machine, one))
                }
                None => false,
            }
        };
        if !is_other {
            continue;
        }
        match settle(&engine.store, &engine.settings.key, name, "centre") {
            Ok(_) => issued += 1,
            Err(NotIssued::Store(error)) => return Err(error),
            Err(other) => {
                let why = other.to_string();
                if before.get(name) != Some(&why) {
                    tracing::error!("the settings of {name} are not sent: {why}");
                }
                unsettled.insert(name.clone(), why);
            }
        }
    }
    Ok(())
}

/// Roll-outs that could not be moved on.
#[derive(Default)]
struct Held {
    /// Why, a sentence each.
    why: Vec<String>,
    /// The machines of those that were moved on, where it is not known which machines the others have.
    moved: Option<BTreeSet<MachineId>>,
    /// Their machines: each is in one roll-out at a time.
    machines: BTreeSet<MachineId>,
}

impl Held {
    /// Whether what was heard of a machine has reached no roll-out that may be its own.
    fn holds(&self, machine: &MachineId) -> bool {
        self.machines.contains(machine)
            || (self.moved.as_ref()).is_some_and(|moved| !moved.contains(machine))
    }
}

/// Moves every roll-out on, each in one transaction with what it issues. One that cannot be moved on holds up no other.
fn roll_out(
    engine: &Engine,
    elapsed_s: f64,
    seen: &BTreeMap<MachineId, Seen>,
    residual_um: &BTreeMap<MachineId, f64>,
) -> Result<Held, StoreError> {
    let open = engine.store.open_rollouts()?;
    if open.is_empty() {
        return Ok(Held::default());
    }
    // What machines have answered is taken from the store at each look: a centre that was killed between an answer and its
    // look hears of it after its start.
    let versions = newest_versions(engine)?;
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
    let mut held = Held::default();
    let (mut moved, mut all_known) = (BTreeSet::new(), true);
    for id in open {
        match move_on(engine, id, &looked) {
            Ok(machines) => moved.extend(machines),
            Err(error) => {
                held.why
                    .push(format!("Roll-out {id} cannot go on: {error}."));
                match engine.store.rollout(id) {
                    Ok(rollout) => held
                        .machines
                        .extend(rollout.into_iter().flat_map(machines_of)),
                    Err(_) => all_known = false,
                }
            }
        }
    }
    held.moved = (!all_known).then_some(moved);
    Ok(held)
}

/// What every roll-out sees at one look.
struct Looked<'a> {
    elapsed_s: f64,
    seen: BTreeMap<MachineId, Seen>,
    /// The last residual that was known, µm.
    residual_um: &'a BTreeMap<MachineId, f64>,
    /// The newest version of each machine.
    versions: BTreeMap<MachineId, Version>,
}

fn machines_of(rollout: Rollout) -> impl Iterator<Item = MachineId> {
    rollout.turns.into_iter().map(|turn| turn.machine)
}

/// Moves one roll-out on, and tells its machines.
fn move_on(
    engine: &Engine,
    id: u64,
    looked: &Looked<'_>,
) -> Result<impl Iterator<Item = MachineId> + use<>, StoreError> {
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
    let answered = rollout.turns.iter().filter_map(|turn| {
        let version = versions.get(&turn.machine)?;
        // What was sent meanwhile with the model of before says nothing of this one.
        let is_of_it = version.rollout.is_none_or(|id| id == rollout.id);
        let outcome = version.outcome.clone()?;
        (is_of_it && turn.step.waits_for(version.version, &outcome)).then(|| Event::Answered {
            machine: turn.machine.clone(),
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
        database: &mut dyn Database,
        rollout: &mut Rollout,
        mut actions: Vec<Action>,
    ) -> Result<(), StoreError> {
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
                    Err(NotIssued::Store(error)) => return Err(error),
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
        database: &mut dyn Database,
        rollout: &Rollout,
        name: &MachineId,
        confirm: Option<String>,
    ) -> Result<Issued, NotIssued> {
        // As it stands in this transaction: it may have been disabled since the look began.
        let machine = machine_named(database, name)?;
        let machine = machine.ok_or_else(|| missing("machine", name.as_str()))?;
        let (model, text) = self.model.ok_or_else(|| missing("model", &rollout.model))?;
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
