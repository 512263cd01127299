//! Alarms: what is wrong now is compared with what is open, and the difference is written down.

use std::{
    collections::{BTreeMap, BTreeSet},
    time::Instant,
};

use volcomp_fleet::MachineId;

use super::{
    Engine,
    causes::{self, Suspect},
    lock,
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

type Key = (Option<MachineId>, AlarmKind);

/// The alarms that are open: number, text, and when the text was written.
#[derive(Default)]
pub(super) struct Open {
    known: Option<BTreeMap<Key, (u64, String, f64)>>,
    unreadable: BTreeMap<MachineId, (Instant, String)>,
    /// Roll-outs that are done: nothing of them is suspect, and nothing of them changes.
    done: BTreeSet<u64>,
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
    let suspects = suspects(engine, state, machines, versions, &lives)?;
    let mut causes = of_machines(engine, state, machines, versions, &suspects, &lives)?;
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
        Ok::<_, StoreError>(ids)
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

/// A roll-out; `None`: there is none, or its document cannot be read, which is told as a roll-out that cannot go on.
fn readable(engine: &Engine, id: u64) -> Result<Option<Rollout>, StoreError> {
    match engine.store.rollout(id) {
        Err(StoreError::Document(_)) => Ok(None),
        other => other,
    }
}

/// The machines that have in force the model of a roll-out that is broken off and that nobody has decided to keep.
fn suspects(
    engine: &Engine,
    state: &mut Open,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
    lives: &BTreeMap<MachineId, Live>,
) -> Result<BTreeMap<MachineId, Suspect>, StoreError> {
    let mut by_rollout: BTreeMap<u64, Vec<&MachineId>> = BTreeMap::new();
    for machine in machines {
        let name = &machine.identity.machine;
        let version = version_in_force(&engine.store, name, versions.get(name), lives.get(name))?;
        if let Some(rollout) = version.and_then(|version| version.rollout)
            && !state.done.contains(&rollout)
        {
            by_rollout.entry(rollout).or_default().push(name);
        }
    }
    let mut suspects = BTreeMap::new();
    for (id, machines) in by_rollout {
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
        for machine in machines {
            if rollout.is_suspect_on(machine) {
                let way_back = back::way(&engine.store, machine, lives.get(machine))?;
                let suspect = Suspect {
                    rollout: id,
                    what: what.clone(),
                    may_go_on: !rollout.phase.is_over(),
                    has_way_back: way_back.is_some(),
                };
                suspects.insert(machine.clone(), suspect);
            }
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
    lives: &BTreeMap<MachineId, Live>,
) -> Result<BTreeMap<Key, String>, StoreError> {
    let models: BTreeMap<String, Model> = (engine.store.models()?.into_iter())
        .map(|model| (model.sha256.clone(), model))
        .collect();
    let mut due = BTreeMap::new();
    for machine in machines.iter().filter(|machine| machine.due_days.is_some()) {
        let name = &machine.identity.machine;
        let Some(newest) = versions.get(name) else {
            continue;
        };
        // A calibration that was refused, or that waits for a person, renews nothing.
        let corrects_by = model_in_force(&engine.store, newest, lives.get(name))?;
        let model = corrects_by.and_then(|model| models.get(&model));
        due.insert(
            name,
            model.and_then(|model| due_days(machine, model, now_s())),
        );
    }
    let clobbered = lock(&engine.clobbered).clone();
    let ingest = lock(&engine.ingest);
    let mut found = BTreeMap::new();
    for machine in machines {
        let name = &machine.identity.machine;
        let version = versions.get(name);
        let unreadable = state.unreadable.get(name);
        let causes = causes::of(&causes::Known {
            machine,
            heard: ingest.machine(name),
            quiet_s: ingest.quiet_s(name),
            version,
            model: version.and_then(|version| models.get(&version.model)),
            suspect: suspects.get(name),
            clobbered_s: clobbered.get(name).map(|at| at.elapsed().as_secs_f64()),
            unreadable: unreadable.map(|(at, why)| (at.elapsed().as_secs_f64(), why.as_str())),
            due_days: due.get(name).copied().flatten(),
            now_s: now_s(),
        });
        for (kind, text) in causes {
            found.insert((Some(name.clone()), kind), text);
        }
    }
    Ok(found)
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

/// What a roll-out waits for, of each machine: a change that a person must confirm, although other settings were sent with the
/// model of before meanwhile; and a correction, without which the model cannot be judged.
fn waiting(rollout: &Rollout, causes: &mut BTreeMap<Key, String>) {
    for target in &rollout.targets {
        let (kind, text) = match &target.step {
            Step::NeedsConfirmation {
                version,
                worst_um,
                worst_urad,
                ..
            } => (
                AlarmKind::NeedsConfirmation,
                causes::needs_confirmation(*version, worst_um, worst_urad),
            ),
            Step::Soaking {
                version, idle_s, ..
            } if *idle_s > rollout.rules.answer_s && rollout.phase == Phase::Running => (
                AlarmKind::Idle,
                format!(
                    "It has version {version} of roll-out {id} in force and has not compensated for {idle_s:.0} s: the roll-out waits until it does. Arm it, or end the roll-out with `rollout stop {id}`.",
                    id = rollout.id
                ),
            ),
            _ => continue,
        };
        let key = (Some(target.machine.clone()), kind);
        causes.entry(key).or_insert(text);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rollout::{Event, NewRollout, Rules, Seen};

    /// The canary has the model in force and never compensates: the roll-out waits, and an alarm says for what.
    #[test]
    fn a_roll_out_that_waits_for_a_correction_raises_an_alarm() {
        let name: MachineId = "mill-1".parse().expect("a name");
        let machines = [(name.clone(), true)];
        let mut rollout = Rollout::new(
            7,
            NewRollout {
                model: "ab".to_owned(),
                machines: &machines,
                rules: Rules::default(),
                by: "anna".to_owned(),
                since_s: 0.0,
            },
        );
        rollout.step(Event::Issued {
            machine: name.clone(),
            version: 3,
            before_um: None,
        });
        let mut look = |corrects: bool, looks: u32| {
            for _ in 0..looks {
                let seen = Seen {
                    heard: true,
                    version: 3,
                    corrects,
                    ..Seen::default()
                };
                rollout.step(Event::Looked {
                    elapsed_s: 10.0,
                    seen: BTreeMap::from([(name.clone(), seen)]),
                });
            }
            let mut causes = BTreeMap::new();
            waiting(&rollout, &mut causes);
            causes.remove(&(Some(name.clone()), AlarmKind::Idle))
        };
        assert_eq!(look(false, 31), None, "it may take 300 s");
        let text = look(false, 1).expect("an alarm");
        assert!(
            text.contains("version 3 of roll-out 7") && text.contains("for 310 s"),
            "{text}"
        );
        assert_eq!(look(true, 1), None, "it compensates");
        assert_eq!(look(false, 2), None, "it is counted anew");
    }
}
