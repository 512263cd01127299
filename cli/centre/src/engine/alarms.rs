//! Alarms: compares current causes with open alarms and stores the difference.

use std::collections::{BTreeMap, BTreeSet};

use volcomp_fleet::MachineId;

use super::{
    Engine,
    causes::{self, Suspect},
    lock,
};
use crate::{
    Error,
    clock::now_s,
    records::{Alarm, AlarmKind, Live, Machine, Version},
    rollout::{Phase, Rollout, Step},
    store::alarms,
    versions::{overdue_days, version_in_force, way_back},
};

/// The text of an open alarm changes no more often than this, s: it may contain an age.
const CHANGE_INTERVAL_S: f64 = 60.0;

type Key = (Option<MachineId>, AlarmKind);

/// State kept between passes.
#[derive(Default)]
pub(super) struct State {
    /// Time of the last text change of each open alarm, by alarm number, s.
    changed_s: BTreeMap<u64, f64>,
    /// Completed roll-outs: they make no machine suspect and do not change any more.
    done: BTreeSet<u64>,
}

/// Raises, closes and updates alarms.
pub(super) fn look(
    engine: &Engine,
    state: &mut State,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
) -> Result<(), Error> {
    let now = now_s();
    let lives: BTreeMap<MachineId, Live> = {
        let ingest = lock(&engine.ingest);
        let lives = ingest.machines();
        lives
            .filter_map(|(name, heard)| Some((name.clone(), heard.live.clone()?)))
            .collect()
    };
    let suspects = suspects(engine, state, machines, versions, &lives)?;
    let mut causes = of_machines(engine, machines, versions, &suspects, &lives)?;
    let over = of_centre(engine, &mut causes)?;
    let open: BTreeMap<Key, Alarm> = (engine.store.open_alarms()?.into_iter())
        .map(|alarm| ((alarm.machine.clone(), alarm.kind), alarm))
        .collect();
    let gone: Vec<u64> = (open.iter())
        .filter(|(key, _)| !causes.contains_key(key))
        .map(|(_, alarm)| alarm.id)
        .collect();
    let (mut raised, mut changed) = (Vec::new(), Vec::new());
    for (key, text) in &causes {
        let Some(alarm) = open.get(key) else {
            raised.push((key, text));
            continue;
        };
        let changed_s = state.changed_s.get(&alarm.id).unwrap_or(&alarm.since_s);
        if alarm.text != *text && !(0.0..CHANGE_INTERVAL_S).contains(&(now - changed_s)) {
            changed.push((alarm.id, text));
        }
    }
    if !gone.is_empty() || !raised.is_empty() || !changed.is_empty() {
        engine.store.write(|database| {
            for id in &gone {
                alarms::clear(database, *id, now)?;
            }
            for (id, text) in &changed {
                alarms::say(database, *id, text)?;
            }
            for ((machine, kind), text) in &raised {
                alarms::raise(database, machine.as_ref(), *kind, text, now)?;
            }
            Ok(())
        })?;
        state
            .changed_s
            .extend(changed.into_iter().map(|(id, _)| (id, now)));
        state.changed_s.retain(|id, _| !gone.contains(id));
    }
    // Remove failures that are over and whose alarm has been stored.
    lock(&engine.troubles).retain(|kind, trouble| !(trouble.over && over.contains(kind)));
    Ok(())
}

/// A roll-out; `None` if it does not exist or its document cannot be read. The latter is reported as a roll-out that cannot proceed.
fn readable(engine: &Engine, id: u64) -> Result<Option<Rollout>, Error> {
    match engine.store.rollout(id) {
        Err(Error::Document(_)) => Ok(None),
        other => other,
    }
}

/// Machines whose active model belongs to a stopped or aborted roll-out and that the user has not decided to keep.
fn suspects(
    engine: &Engine,
    state: &mut State,
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
    lives: &BTreeMap<MachineId, Live>,
) -> Result<BTreeMap<MachineId, Suspect>, Error> {
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
                let way_back = way_back(&engine.store, machine, lives.get(machine))?;
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
    machines: &[Machine],
    versions: &BTreeMap<MachineId, Version>,
    suspects: &BTreeMap<MachineId, Suspect>,
    lives: &BTreeMap<MachineId, Live>,
) -> Result<BTreeMap<Key, String>, Error> {
    let models = engine.store.newest_models()?;
    let now_s = now_s();
    let mut due = BTreeMap::new();
    for machine in machines {
        let name = &machine.identity.machine;
        let (newest, live) = (versions.get(name), lives.get(name));
        let days = overdue_days(&engine.store, machine, newest, live, &models, now_s)?;
        due.insert(name, days);
    }
    let clobbered = lock(&engine.clobbered).clone();
    let ingest = lock(&engine.ingest);
    let mut found = BTreeMap::new();
    for machine in machines {
        let name = &machine.identity.machine;
        let version = versions.get(name);
        let causes = causes::of(&causes::Known {
            machine,
            heard: ingest.machine(name),
            quiet_s: ingest.quiet_s(name),
            version,
            model: version.and_then(|version| models.get(&version.model)),
            suspect: suspects.get(name),
            clobbered_s: clobbered.get(name).map(|at| at.elapsed().as_secs_f64()),
            due_days: due.get(name).copied().flatten(),
            now_s,
        });
        for (kind, text) in causes {
            found.insert((Some(name.clone()), kind), text);
        }
    }
    Ok(found)
}

/// Adds the centre's own failures and what its roll-outs wait for; returns the kinds of failures that are over.
fn of_centre(engine: &Engine, causes: &mut BTreeMap<Key, String>) -> Result<Vec<AlarmKind>, Error> {
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
        // In addition to those that cannot proceed.
        let text = causes.entry((None, AlarmKind::Rollout)).or_default();
        if !text.is_empty() {
            text.push(' ');
        }
        text.push_str(&stopped.join(" "));
    }
    Ok(over)
}

/// What a roll-out waits for, by machine: a change that the operator must confirm, even if other settings were since sent with the previous model;
/// and an active correction, without which the model cannot be judged.
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
    use crate::rollout::{Event, Observation, Rules};

    /// The canary has the model in force and never compensates: the roll-out waits, and an alarm says for what.
    #[test]
    fn a_roll_out_that_waits_for_a_correction_raises_an_alarm() {
        let name: MachineId = "mill-1".parse().expect("a name");
        let machines = [(name.clone(), true)];
        let mut rollout = Rollout::new(7, "ab", &machines, Rules::default(), "anna", 0.0);
        rollout.step(Event::Issued {
            machine: name.clone(),
            version: 3,
            before_um: None,
        });
        let mut look = |corrects: bool, looks: u32| {
            for _ in 0..looks {
                let seen = Observation {
                    heard: true,
                    version: 3,
                    corrects,
                    ..Observation::default()
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
