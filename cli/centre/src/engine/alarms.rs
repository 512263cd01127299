//! Alarms: what is wrong now is compared with what is open, and the difference is written down.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Instant,
};

use volcomp_fleet::MachineId;

use super::{
    Engine,
    causes::{self, Suspect},
    writer::lock,
};
use crate::{
    back,
    clock::now_s,
    drift::{due_days, model_in_force, version_in_force},
    ingest::Since,
    records::{AlarmKind, Live, Machine, Model, Version},
    rollout::{Phase, Rollout, Step},
    store::{StoreError, alarms},
};

/// A text of an alarm that is open is written anew so often: it may tell an age.
const SAY_EVERY_S: f64 = 60.0;

/// Models are read anew so often, s.
const READ_EVERY_S: f64 = 60.0;

type Key = (Option<MachineId>, AlarmKind);

/// From what it is learned which version is in force: the newest version with when it was answered, and the version that the machine
/// tells.
type Told = (Option<(u64, Option<f64>)>, u64);

fn told(newest: Option<&Version>, live: Option<&Live>) -> Told {
    let newest = newest.map(|newest| (newest.version, newest.answered_s));
    (newest, live.map_or(0, |live| live.version))
}

/// The alarms that are open: number, text, and when the text was written.
#[derive(Default)]
pub(super) struct Open {
    known: Option<BTreeMap<Key, (u64, String, f64)>>,
    unreadable: BTreeMap<MachineId, (Instant, String)>,
    models: BTreeMap<String, Model>,
    /// When the models were read: the day of their measurements may be stated later.
    models_read: Option<Instant>,
    /// At what it was learned, and the model that a machine corrects by, of machines whose calibration
    /// can be due.
    in_force: BTreeMap<MachineId, (Told, Option<String>)>,
    /// The roll-out of the version in force of each machine.
    of_rollout: BTreeMap<MachineId, (Told, Option<u64>)>,
    /// Roll-outs that are done: nothing of them is suspect, and nothing of them changes.
    done: BTreeSet<u64>,
    /// Whether there is a model to go back to, of suspect machines, and when that was read: it changes with what becomes of other
    /// roll-outs.
    ways_back: BTreeMap<MachineId, (Instant, bool)>,
}

/// Raises, closes, and says more.
pub(super) fn look(
    engine: &Engine,
    state: &mut Open,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
    since: &BTreeMap<MachineId, Since>,
) -> Result<(), StoreError> {
    let now = now_s();
    for (machine, since) in since {
        if since.unreadable > 0 {
            let told = (Instant::now(), since.why_unreadable.clone());
            state.unreadable.insert(machine.clone(), told);
        }
    }
    let lives: BTreeMap<MachineId, Live> = {
        let ingest = lock(&engine.ingest);
        let lives = ingest.machines();
        lives
            .filter_map(|(name, heard)| Some((name.clone(), heard.live.clone()?)))
            .collect()
    };
    learn_in_force(engine, &mut state.in_force, machines, versions, &lives)?;
    let read = state.models_read;
    if read.is_none_or(|read| read.elapsed().as_secs_f64() >= READ_EVERY_S) {
        state.models.clear();
        state.models_read = Some(Instant::now());
    }
    learn_models(engine, &mut state.models, versions, &state.in_force)?;
    let rollouts = learn_rollouts(engine, &mut state.of_rollout, machines, versions, &lives)?;
    let suspects = suspects(engine, state, &rollouts, &lives)?;
    let mut causes = of_machines(engine, state, machines, versions, &suspects, now);
    let over = of_centre(engine, &mut causes)?;
    let open = if let Some(open) = &mut state.known {
        open
    } else {
        let open = engine.store.open_alarms()?.into_iter();
        state.known.insert(
            open.map(|alarm| ((alarm.machine, alarm.kind), (alarm.id, alarm.text, now)))
                .collect(),
        )
    };
    let gone: Vec<Key> = (open.keys())
        .filter(|key| !causes.contains_key(key))
        .cloned()
        .collect();
    let fresh = causes.iter().filter(|(key, text)| {
        open.get(key).is_none_or(|(_, told, at_s)| {
            told != *text && !(0.0..SAY_EVERY_S).contains(&(now - at_s))
        })
    });
    let fresh: Vec<(&Key, &String)> = fresh.collect();
    if gone.is_empty() && fresh.is_empty() {
        forget(engine, &over);
        return Ok(());
    }
    let known: &BTreeMap<Key, (u64, String, f64)> = open;
    let written = engine.store.write(|database| {
        for key in &gone {
            if let Some((id, ..)) = known.get(key) {
                alarms::clear(database, *id, now)?;
            }
        }
        let mut ids = Vec::new();
        for ((machine, kind), text) in &fresh {
            let key = (machine.clone(), *kind);
            ids.push(match known.get(&key) {
                Some((id, ..)) => {
                    alarms::say(database, *id, text)?;
                    *id
                }
                None => alarms::raise(database, machine.as_ref(), *kind, text, now)?,
            });
        }
        Ok(ids)
    });
    let ids = match written {
        Ok(ids) => ids,
        Err(error) => {
            // It may be written although nobody has said so: the next look reads what is open.
            state.known = None;
            return Err(error);
        }
    };
    for ((key, text), id) in fresh.into_iter().zip(ids) {
        open.insert(key.clone(), (id, text.clone(), now));
    }
    for key in gone {
        open.remove(&key);
    }
    forget(engine, &over);
    Ok(())
}

/// Forgets troubles that are over and of which an alarm was written.
fn forget(engine: &Engine, over: &[AlarmKind]) {
    lock(&engine.troubles).retain(|kind, trouble| !(trouble.over && over.contains(kind)));
}

/// Reads the models that are not known yet.
fn learn_models(
    engine: &Engine,
    models: &mut BTreeMap<String, Model>,
    versions: &BTreeMap<MachineId, Version>,
    in_force: &BTreeMap<MachineId, (Told, Option<String>)>,
) -> Result<(), StoreError> {
    let of_versions = versions.values().map(|version| &version.model);
    let of_machines = in_force.values().filter_map(|(_, model)| model.as_ref());
    let used: BTreeSet<&String> = of_versions.chain(of_machines).collect();
    for sha256 in &used {
        if !models.contains_key(*sha256)
            && let Some(model) = engine.store.model(sha256)?
        {
            models.insert((*sha256).clone(), model);
        }
    }
    models.retain(|sha256, _| used.contains(sha256));
    Ok(())
}

/// Learns by which model each machine corrects: a calibration that was refused, or that waits for a person, renews nothing.
fn learn_in_force(
    engine: &Engine,
    in_force: &mut BTreeMap<MachineId, (Told, Option<String>)>,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
    lives: &BTreeMap<MachineId, Live>,
) -> Result<(), StoreError> {
    let due = machines.iter().filter(|machine| machine.due_days.is_some());
    let mut learned = BTreeMap::new();
    for machine in due {
        let name = &machine.identity.machine;
        let Some(newest) = versions.get(name) else {
            continue;
        };
        let live = lives.get(name);
        let at = told(Some(newest), live);
        let known = in_force.remove(name).filter(|(known, _)| *known == at);
        let model = match known {
            Some((_, model)) => model,
            None => model_in_force(&engine.store, newest, live)?,
        };
        learned.insert(name.clone(), (at, model));
    }
    *in_force = learned;
    Ok(())
}

/// A roll-out; `None`: there is none, or its document cannot be read, which is told as a roll-out that cannot go on.
fn readable(engine: &Engine, id: u64) -> Result<Option<Rollout>, StoreError> {
    match engine.store.rollout(id) {
        Err(StoreError::Document(_)) => Ok(None),
        other => other,
    }
}

/// The roll-out of the version that each machine has in force, where there is one.
fn learn_rollouts(
    engine: &Engine,
    learned: &mut BTreeMap<MachineId, (Told, Option<u64>)>,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
    lives: &BTreeMap<MachineId, Live>,
) -> Result<BTreeMap<MachineId, u64>, StoreError> {
    let mut found = BTreeMap::new();
    let mut before = std::mem::take(learned);
    for machine in machines {
        let name = &machine.identity.machine;
        let (newest, live) = (versions.get(name), lives.get(name));
        let at = told(newest, live);
        let known = before.remove(name).filter(|(known, _)| *known == at);
        let rollout = match known {
            Some((_, rollout)) => rollout,
            None => version_in_force(&engine.store, name, newest, live)?
                .and_then(|version| version.rollout),
        };
        learned.insert(name.clone(), (at, rollout));
        if let Some(rollout) = rollout {
            found.insert(name.clone(), rollout);
        }
    }
    Ok(found)
}

/// The machines that have in force the model of a roll-out that is broken off and that nobody has decided to keep.
fn suspects(
    engine: &Engine,
    state: &mut Open,
    rollouts: &BTreeMap<MachineId, u64>,
    lives: &BTreeMap<MachineId, Live>,
) -> Result<BTreeMap<MachineId, Suspect>, StoreError> {
    let open: BTreeSet<u64> = (rollouts.values().copied())
        .filter(|id| !state.done.contains(id))
        .collect();
    let mut suspects = BTreeMap::new();
    let mut ways_back = std::mem::take(&mut state.ways_back);
    for id in open {
        let Some(rollout) = readable(engine, id)? else {
            continue;
        };
        let what = match &rollout.phase {
            Phase::Stopped { why } => format!("has stopped ({why})"),
            Phase::Aborted { by } => format!("was ended by {by} before it was done"),
            Phase::Done => {
                state.done.insert(id);
                continue;
            }
            Phase::Running | Phase::Paused { .. } => continue,
        };
        let of_it = rollouts.iter().filter(|(_, of)| **of == id);
        for (machine, _) in of_it.filter(|(machine, _)| rollout.is_suspect_on(machine)) {
            let known = ways_back.remove(machine);
            let known = known.filter(|(at, _)| at.elapsed().as_secs_f64() < READ_EVERY_S);
            let (at, has_way_back) = if let Some(known) = known {
                known
            } else {
                let way = back::way(&engine.store, machine, lives.get(machine))?;
                (Instant::now(), way.is_some())
            };
            state.ways_back.insert(machine.clone(), (at, has_way_back));
            let suspect = Suspect {
                rollout: id,
                what: what.clone(),
                may_go_on: !rollout.phase.is_over(),
                has_way_back,
            };
            suspects.insert(machine.clone(), suspect);
        }
    }
    Ok(suspects)
}

fn of_machines(
    engine: &Engine,
    state: &Open,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
    suspects: &BTreeMap<MachineId, Suspect>,
    now_s: f64,
) -> BTreeMap<Key, String> {
    let clobbered = lock(&engine.clobbered).clone();
    let ingest = lock(&engine.ingest);
    let mut found = BTreeMap::new();
    for machine in machines {
        let name = &machine.identity.machine;
        let version = versions.get(name);
        let model = version.and_then(|version| state.models.get(&version.model));
        let corrects = state
            .in_force
            .get(name)
            .and_then(|(_, model)| model.as_ref());
        let corrects = corrects.and_then(|model| state.models.get(model));
        let unreadable = state.unreadable.get(name);
        let causes = causes::of(&causes::Known {
            machine,
            heard: ingest.machine(name),
            quiet_s: ingest.quiet_s(name),
            version,
            model,
            suspect: suspects.get(name),
            clobbered_s: clobbered.get(name).map(|at| at.elapsed().as_secs_f64()),
            unreadable: unreadable.map(|(at, why)| (at.elapsed().as_secs_f64(), why.as_str())),
            due_days: corrects.and_then(|model| due_days(machine, model, now_s)),
            now_s,
        });
        for (kind, text) in causes {
            found.insert((Some(name.clone()), kind), text);
        }
    }
    found
}

/// What the centre itself has trouble with, which of it is over; and what its roll-outs wait for.
fn of_centre(
    engine: &Engine,
    causes: &mut BTreeMap<Key, String>,
) -> Result<Vec<AlarmKind>, StoreError> {
    let mut over = Vec::new();
    for (kind, trouble) in lock(&engine.troubles).iter() {
        causes.insert((None, *kind), trouble.text.clone());
        if trouble.over {
            over.push(*kind);
        }
    }
    let mut stopped = Vec::new();
    for id in engine.store.open_rollouts()? {
        let Some(rollout) = readable(engine, id)? else {
            continue;
        };
        waiting(&rollout, causes);
        if let Phase::Stopped { why } = rollout.phase {
            stopped.push(format!("Roll-out {id} has stopped: {why}."));
        }
    }
    if !stopped.is_empty() {
        // Beside those that cannot go on.
        let text = causes.entry((None, AlarmKind::Rollout)).or_default();
        if !text.is_empty() {
            text.push(' ');
        }
        text.push_str(&stopped.join(" "));
    }
    Ok(over)
}

/// A change that a person must confirm, although other settings were sent with the model of before meanwhile.
fn waiting(rollout: &Rollout, causes: &mut BTreeMap<Key, String>) {
    for target in &rollout.targets {
        if let Step::NeedsConfirmation {
            version,
            worst_um,
            worst_urad,
            ..
        } = &target.step
        {
            let key = (Some(target.machine.clone()), AlarmKind::NeedsConfirmation);
            let text = || causes::needs_confirmation(*version, worst_um, worst_urad);
            causes.entry(key).or_insert_with(text);
        }
    }
}
