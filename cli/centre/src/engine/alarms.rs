//! Alarms: an alarm is open exactly while its cause is present. The causes of a machine are a pure function of its state.

use std::collections::{BTreeMap, BTreeSet};

use volcomp_fleet::{MachineId, Outcome, largest_moves};

use super::{Engine, lock};
use crate::{
    Error,
    clock::now_s,
    ingest::Reception,
    records::{Alarm, AlarmKind, Live, Machine, Model, Version},
    rollout::{Phase, Rollout, Step},
    store::history,
    versions::{load_active_version, overdue_days, way_back},
};

/// Minimum interval between changes of the text of an open alarm, s: the text may contain an age.
const CHANGE_INTERVAL_S: f64 = 60.0;

/// Time an alarm for two simultaneous gateways stays open after the last detection, s.
const CLONE_ALARM_S: f64 = 60.0;
/// Time an alarm for a momentary event stays open, s.
const EVENT_ALARM_S: f64 = 600.0;
/// Maximum time until a machine has applied its newest version, s.
const ACTIVATION_TIMEOUT_S: f64 = 600.0;

type Key = (Option<MachineId>, AlarmKind);

#[derive(Default)]
pub(super) struct State {
    /// Time of the last text change of each open alarm, by alarm number, s.
    changed_s: BTreeMap<u64, f64>,
    /// Completed roll-outs, which need not be read again: their models were validated, and they do not change.
    done: BTreeSet<u64>,
}

pub(super) fn update(
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
            .filter_map(|(name, reception)| Some((name.clone(), reception.live.clone()?)))
            .collect()
    };
    let suspects = suspects(engine, state, machines, versions, &lives)?;
    let mut causes = machine_causes(engine, machines, versions, &suspects, &lives)?;
    let over = add_centre_causes(engine, &mut causes)?;
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
                history::clear(database, *id, now)?;
            }
            for (id, text) in &changed {
                history::set_text(database, *id, text)?;
            }
            for ((machine, kind), text) in &raised {
                history::raise(database, machine.as_ref(), *kind, text, now)?;
            }
            Ok(())
        })?;
        state.changed_s.extend(changed.into_iter().map(|(id, _)| (id, now)));
        state.changed_s.retain(|id, _| !gone.contains(id));
    }
    // Remove failures that are over and whose alarm has been stored.
    lock(&engine.failures).retain(|kind, failure| !(failure.over && over.contains(kind)));
    Ok(())
}

/// Reads a roll-out. Returns `None` if the roll-out does not exist or its document cannot be read; an unreadable
/// document is reported as a roll-out that cannot proceed.
fn readable(engine: &Engine, id: u64) -> Result<Option<Rollout>, Error> {
    match engine.store.rollout(id) {
        Err(Error::Document(_)) => Ok(None),
        other => other,
    }
}

/// Machines whose active model belongs to a stopped or aborted roll-out, unless the user has decided to keep the model.
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
        let version =
            load_active_version(&engine.store, name, versions.get(name), lives.get(name))?;
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
                    can_resume: !rollout.phase.is_over(),
                    has_way_back: way_back.is_some(),
                };
                suspects.insert(machine.clone(), suspect);
            }
        }
    }
    Ok(suspects)
}

fn machine_causes(
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
        let causes = causes_of(&MachineState {
            machine,
            reception: ingest.machine(name),
            silence_s: ingest.silence_s(name),
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

/// Adds the centre's own failures, and the roll-outs that wait for confirmations or machines.
/// Returns the kinds of failures that are over.
fn add_centre_causes(
    engine: &Engine,
    causes: &mut BTreeMap<Key, String>,
) -> Result<Vec<AlarmKind>, Error> {
    let mut over = Vec::new();
    for (kind, failure) in lock(&engine.failures).iter() {
        causes.insert((None, *kind), failure.text.clone());
        if failure.over {
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
        // The alarm may already list machines for which a roll-out waits.
        let text = causes.entry((None, AlarmKind::Rollout)).or_default();
        if !text.is_empty() {
            text.push(' ');
        }
        text.push_str(&stopped.join(" "));
    }
    Ok(over)
}

/// Adds an alarm for each machine that blocks a roll-out, with the reason. Either the operator must confirm a change,
/// or the correction is inactive, so that the model cannot be judged. A change awaits confirmation even if a later
/// manifest has sent other settings with the previous model.
fn waiting(rollout: &Rollout, causes: &mut BTreeMap<Key, String>) {
    for target in &rollout.targets {
        let (kind, text) = match &target.step {
            Step::NeedsConfirmation { version, worst_um, worst_urad, differences, .. } => (
                AlarmKind::NeedsConfirmation,
                needs_confirmation(*version, (worst_um, worst_urad), differences),
            ),
            Step::Soaking { version, idle_s, .. }
                if *idle_s > rollout.rules.answer_s && rollout.phase == Phase::Running =>
            {
                (
                    AlarmKind::Idle,
                    format!(
                        "Version {version} of roll-out {id} is active, but the machine has not compensated for {idle_s:.0} s: the roll-out waits until it does. Arm it, or end the roll-out with `rollout stop {id}`.",
                        id = rollout.id
                    ),
                )
            }
            _ => continue,
        };
        let key = (Some(target.machine.clone()), kind);
        causes.entry(key).or_insert(text);
    }
}

struct MachineState<'a> {
    machine: &'a Machine,
    reception: Option<&'a Reception>,
    /// Time since the last condition of the machine by a monotonic clock, s.
    silence_s: f64,
    version: Option<&'a Version>,
    model: Option<&'a Model>,
    /// The roll-out of the active version, if it stopped or was aborted.
    suspect: Option<&'a Suspect>,
    /// Time since a foreign value was found under the key of the machine, s.
    clobbered_s: Option<f64>,
    due_days: Option<f64>,
    now_s: f64,
}

/// A stopped or aborted roll-out whose model is active on a machine.
#[derive(Clone, Debug, PartialEq)]
struct Suspect {
    rollout: u64,
    what: String,
    /// True if the user can still resume the roll-out: its machines are in no other roll-out.
    can_resume: bool,
    has_way_back: bool,
}

impl Suspect {
    fn text(&self, name: &MachineId) -> String {
        let Self { rollout, what, .. } = self;
        let stop = if self.can_resume {
            format!("after `rollout stop {rollout}` ")
        } else {
            String::new()
        };
        let back = if self.has_way_back {
            format!("{stop}`model back {name}` restores the previous model")
        } else {
            format!(
                "there is no previous model to restore; `machine disable {name}` ends its correction"
            )
        };
        format!(
            "It corrects with the model of roll-out {rollout}, which {what}: {back}; `rollout keep {rollout} {name}` keeps the model."
        )
    }
}

fn causes_of(known: &MachineState<'_>) -> BTreeMap<AlarmKind, String> {
    let mut causes = BTreeMap::new();
    if let Some(ago_s) = known.clobbered_s.filter(|ago_s| *ago_s < EVENT_ALARM_S) {
        causes.insert(
            AlarmKind::Clobbered,
            format!(
                "A foreign value was found under its key {ago_s:.0} s ago and replaced. The machine rejects foreign values, but an unauthorised client has access to the server."
            ),
        );
    }
    let unreadable = known.reception.and_then(|reception| reception.unreadable.as_ref());
    let unreadable = unreadable.map(|(at, why)| (at.elapsed().as_secs_f64(), why));
    if let Some((ago_s, why)) = unreadable.filter(|(ago_s, _)| *ago_s < EVENT_ALARM_S) {
        causes.insert(
            AlarmKind::Unreadable,
            format!("A message could not be read or stored {ago_s:.0} s ago: {why}."),
        );
    }
    if let Some(days) = known.due_days.filter(|days| *days >= 0.0) {
        causes.insert(AlarmKind::Due, format!("The calibration has been due for {days:.0} days."));
    }
    if let Some(suspect) = known.suspect {
        let text = suspect.text(&known.machine.identity.machine);
        causes.insert(AlarmKind::Suspect, text);
    }
    add_version_causes(known, &mut causes);
    add_reception_causes(known, &mut causes);
    causes
}

fn needs_confirmation(
    version: u64,
    (worst_um, worst_urad): (&str, &str),
    differences: &[String],
) -> String {
    format!(
        "Version {version} moves the axes by up to {}: a user must confirm it.",
        largest_moves(worst_um, worst_urad, differences)
    )
}

fn add_version_causes(known: &MachineState<'_>, causes: &mut BTreeMap<AlarmKind, String>) {
    let Some(version) = known.version else { return };
    match &version.outcome {
        Some(Outcome::Refused { why }) => {
            causes.insert(
                AlarmKind::Refused,
                format!("It has rejected version {}: {why}.", version.version),
            );
        }
        Some(Outcome::NeedsConfirmation { worst_um, worst_urad, differences, .. }) => {
            causes.insert(
                AlarmKind::NeedsConfirmation,
                needs_confirmation(version.version, (worst_um, worst_urad), differences),
            );
        }
        Some(Outcome::Activated) | None => {}
    }
    let live = known.reception.and_then(|reception| reception.live.as_ref());
    let Some(live) = live else {
        return;
    };
    let other = if live.version == version.version {
        let shall = known.model.map(|model| &model.checksum);
        (live.condition.is_some() && shall.is_some_and(|shall| *shall != live.model))
            .then(|| format!("its active model is {}", live.model))
    } else {
        let waits = version.outcome.is_none() || version.outcome == Some(Outcome::Activated);
        (waits && known.now_s - version.issued_s > ACTIVATION_TIMEOUT_S)
            .then(|| format!("version {} is active", live.version))
    };
    if let Some(other) = other {
        causes.insert(
            AlarmKind::OtherModel,
            format!(
                "Its desired version is {} of {}, but {other}.",
                version.version,
                known.model.map_or("a model", |model| &model.name)
            ),
        );
    }
}

fn add_reception_causes(known: &MachineState<'_>, causes: &mut BTreeMap<AlarmKind, String>) {
    let Some(reception) = known.reception else {
        return;
    };
    let Some(live) = &reception.live else { return };
    if known.machine.is_silent(known.silence_s) {
        causes.insert(
            AlarmKind::Silent,
            "No condition is received from it. It continues with its active model.".to_owned(),
        );
    }
    if reception.instances.cloned_s.is_some_and(|at_s| live.heard_s - at_s < CLONE_ALARM_S) {
        let names: Vec<&str> = (reception.instances.active_since(live.heard_s - CLONE_ALARM_S))
            .map(|one| one.instance.as_str())
            .collect();
        causes.insert(
            AlarmKind::Clone,
            format!(
                "Gateways {} use its identity at the same time: one of them is a copy.",
                names.join(" and ")
            ),
        );
    }
    if live.lost > 0 {
        causes.insert(
            AlarmKind::Gap,
            format!(
                "{} messages are missing: it dropped them because its storage was full, or another gateway sent them.",
                live.lost
            ),
        );
    }
    let Some(condition) = &live.condition else {
        return;
    };
    if condition.state == "faulted" {
        causes.insert(
            AlarmKind::Faulted,
            format!("Its guard is faulted: {}.", condition.reasons.join("; ")),
        );
    }
    let broken: Vec<&str> = (condition.temperatures_degc.iter())
        .filter(|(_, degc)| degc.is_none())
        .map(|(name, _)| name.as_str())
        .collect();
    if !broken.is_empty() {
        causes.insert(
            AlarmKind::Sensor,
            format!("Temperatures are not used: {}.", broken.join(", ")),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rollout::{Event, Observation, Rules};

    /// The canary activates the model but never compensates: the roll-out waits, and an alarm
    /// states the reason.
    #[test]
    fn a_rollout_that_waits_for_compensation_raises_an_alarm() {
        let name: MachineId = "mill-1".parse().expect("a name");
        let machines = [(name.clone(), true)];
        let mut rollout = Rollout::new(7, "ab", &machines, Rules::default(), "anna", 0.0);
        rollout.step(Event::Issued { machine: name.clone(), version: 3, before_um: None });
        let mut look = |corrects: bool, passes: u32| {
            for _ in 0..passes {
                let seen =
                    Observation { reachable: true, version: 3, corrects, ..Observation::default() };
                rollout.step(Event::Pass {
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
        assert!(text.contains("Version 3 of roll-out 7") && text.contains("for 310 s"), "{text}");
        assert_eq!(look(true, 1), None, "it compensates");
        assert_eq!(look(false, 2), None, "it is counted anew");
    }

    #[test]
    fn a_suspect_alarm_names_only_available_remedies() {
        let name = "mill-1".parse().expect("a name");
        let mut suspect = Suspect {
            rollout: 3,
            what: "was ended by anna before it was done".to_owned(),
            can_resume: false,
            has_way_back: true,
        };
        assert_eq!(
            suspect.text(&name),
            "It corrects with the model of roll-out 3, which was ended by anna before it was done: `model back mill-1` restores the previous model; `rollout keep 3 mill-1` keeps the model."
        );
        suspect.can_resume = true;
        assert!(suspect.text(&name).contains("after `rollout stop 3` `model back mill-1`"));
        suspect.has_way_back = false;
        let reported = suspect.text(&name);
        assert!(!reported.contains("model back"), "{reported}");
        assert!(reported.contains("`machine disable mill-1`"), "{reported}");
    }
}
