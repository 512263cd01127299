//! Which version of a machine is in force, and the way back: the model that it has had in force before the one that it has now.

use std::collections::{BTreeMap, BTreeSet};

use volcomp_fleet::{MachineId, Outcome};

use crate::{
    Error,
    models::{due_days, fits},
    records::{Live, Machine, Model, Version},
    rollout::{Rollout, Rules},
    store::Store,
};

/// Whether a machine may correct by the model of this version: it has neither refused it, nor does it wait for a person, nor was
/// it taken back.
pub(crate) fn may_be_in_force(version: &Version) -> bool {
    !version.withdrawn
        && !matches!(
            version.outcome,
            Some(Outcome::Refused { .. } | Outcome::NeedsConfirmation { .. })
        )
}

/// The version by whose model a machine corrects, by [`in_force`], of a machine whose `newest` version is known: where it tells
/// that one, no other is read.
pub(crate) fn version_in_force(
    store: &Store,
    machine: &MachineId,
    newest: Option<&Version>,
    live: Option<&Live>,
) -> Result<Option<Version>, Error> {
    let told = live.map_or(0, |live| live.version);
    match newest {
        Some(newest) if newest.version == told => Ok(Some(newest.clone())),
        None if told == 0 => Ok(None),
        _ => Ok(in_force(&store.versions(machine)?, live).cloned()),
    }
}

/// The version by whose model a machine corrects: the one that it tells; where none is known of what it tells, or it has answered
/// since that a newer one is in force, the newest that it has put in force and that was not taken back. `versions` begins with
/// the newest.
pub fn in_force<'a>(versions: &'a [Version], live: Option<&Live>) -> Option<&'a Version> {
    let told = live.and_then(|live| {
        let mut each = versions.iter();
        each.find(|version| version.version == live.version)
    });
    let told_s = live.and_then(Live::made).map(|made| made.at_s);
    let is_active = |version: &&Version| {
        let is_newer = told.is_none_or(|told| {
            // Conditions may be rarer than answers.
            let is_later = version
                .answered_s
                .zip(told_s)
                .is_some_and(|(at, told)| at > told);
            version.version > told.version && is_later
        });
        is_newer && !version.withdrawn && version.outcome == Some(Outcome::Activated)
    };
    versions.iter().find(is_active).or(told)
}

/// The checksum of that model, where the newest version is known; older ones are read where they are needed. Where nothing tells
/// what is in force it is the newest that may be.
fn model_in_force(
    store: &Store,
    newest: &Version,
    live: Option<&Live>,
) -> Result<Option<String>, Error> {
    if live.is_some_and(|live| live.version == newest.version) {
        return Ok(Some(newest.model.clone()));
    }
    let versions = store.versions(&newest.machine)?;
    let may_be = || versions.iter().find(|version| may_be_in_force(version));
    let version = in_force(&versions, live).or_else(may_be);
    Ok(version.map(|version| version.model.clone()))
}

/// For how many days a calibration of a machine has been due; see [`due_days`]. A calibration that was refused, or that waits for a
/// confirmation, renews nothing. `models` are those of the newest versions; an older one is read.
pub(crate) fn overdue_days(
    store: &Store,
    machine: &Machine,
    newest: Option<&Version>,
    live: Option<&Live>,
    models: &BTreeMap<String, Model>,
    now_s: f64,
) -> Result<Option<f64>, Error> {
    let Some(newest) = newest.filter(|_| machine.due_days.is_some()) else {
        return Ok(None);
    };
    let Some(sha256) = model_in_force(store, newest, live)? else {
        return Ok(None);
    };
    if let Some(model) = models.get(&sha256) {
        return Ok(due_days(machine, model, now_s));
    }
    let model = store.model_with(&sha256)?;
    Ok(model.and_then(|model| due_days(machine, &model, now_s)))
}

/// The newest version whose model was in force before the one that the machine has now; `None`: there was no other.
///
/// `versions` begins with the newest. What was taken back is none, nor what is of a roll-out that was `broken_off` and that nobody
/// has decided to keep.
fn before<'a>(
    versions: &'a [Version],
    live: Option<&Live>,
    broken_off: &BTreeSet<u64>,
) -> Option<&'a Version> {
    let now = in_force(versions, live)?;
    versions.iter().find(|version| {
        version.version < now.version
            && version.outcome == Some(Outcome::Activated)
            && version.model != now.model
            && !version.withdrawn
            && !version.rollout.is_some_and(|id| broken_off.contains(&id))
    })
}

/// The roll-outs of these versions of a machine that were broken off, without those whose model it shall keep.
fn broken_off(
    store: &Store,
    machine: &MachineId,
    versions: &[Version],
) -> Result<BTreeSet<u64>, Error> {
    let all: BTreeSet<u64> = versions.iter().filter_map(|one| one.rollout).collect();
    let mut found = BTreeSet::new();
    for id in all {
        let rollout = store.rollout(id)?;
        if rollout.is_some_and(|rollout| rollout.is_suspect_on(machine)) {
            found.insert(id);
        }
    }
    Ok(found)
}

/// The version whose model a machine can be given back; `None`: it has had no other in force, or what it had was broken off.
pub(crate) fn way_back(
    store: &Store,
    machine: &MachineId,
    live: Option<&Live>,
) -> Result<Option<Version>, Error> {
    let versions = store.versions(machine)?;
    let broken_off = broken_off(store, machine, &versions)?;
    Ok(before(&versions, live, &broken_off).cloned())
}

/// Starts a roll-out of that model to the machine: it gets a version that is higher than all before, and is watched as with any
/// other.
///
/// # Errors
/// There is none, or the machine has its turn in a roll-out that is not over.
pub fn start_way_back(
    store: &Store,
    machine: &MachineId,
    rules: Rules,
    by: &str,
) -> Result<(Rollout, Model), Error> {
    let none = || Error::NoWayBack {
        machine: machine.clone(),
    };
    let known = store.machine(machine)?.ok_or_else(none)?;
    let live = store.live_of(machine)?;
    let version = way_back(store, machine, live.as_ref())?.ok_or_else(none)?;
    let model = store.model(&version.model)?.ok_or_else(none)?;
    fits(&model, &known)?;
    let machines = [(machine.clone(), true)];
    let rollout = store.begin_rollout(&model.sha256, &machines, rules, by)?;
    Ok((rollout, model))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn version(version: u64, model: &str, rollout: u64, withdrawn: bool) -> Version {
        Version {
            machine: "mill-1".parse().expect("a name"),
            version,
            model: model.to_owned(),
            enable: true,
            confirm: None,
            condition_s: None,
            telemetry_s: None,
            value_sha256: String::new(),
            rollout: Some(rollout),
            issued_s: 0.0,
            by: "anna".to_owned(),
            outcome: Some(Outcome::Activated),
            answered_s: Some(version as f64),
            withdrawn,
        }
    }

    fn live(version: u64) -> Live {
        Live::new("mill-1".parse().expect("a name"), 0.0, version)
    }

    fn found(versions: &[Version], live: Option<&Live>, broken_off: &[u64]) -> Option<u64> {
        let broken_off = broken_off.iter().copied().collect();
        before(versions, live, &broken_off).map(|version| version.version)
    }

    #[test]
    fn what_was_taken_back_is_no_way_back() {
        let versions = [
            version(3, "M0", 1, false),
            version(2, "M1", 2, true),
            version(1, "M0", 1, false),
        ];
        assert_eq!(found(&versions, Some(&live(3)), &[]), None);
        assert_eq!(found(&versions, None, &[]), None);
        // It has what was taken back.
        assert_eq!(found(&versions, Some(&live(2)), &[]), Some(1));
    }

    #[test]
    fn what_was_broken_off_is_no_way_back_unless_it_is_kept() {
        let versions = [
            version(3, "M2", 3, false),
            version(2, "M1", 2, false),
            version(1, "M0", 1, false),
        ];
        assert_eq!(found(&versions, None, &[2]), Some(1));
        assert_eq!(found(&versions, None, &[]), Some(2));
    }

    #[test]
    fn what_the_machine_tells_is_in_force() {
        let versions = [
            version(3, "M0", 1, false),
            version(2, "M1", 2, true),
            version(1, "M0", 1, false),
        ];
        let number = |live: Option<&Live>| in_force(&versions, live).map(|one| one.version);
        assert_eq!(number(Some(&live(2))), Some(2));
        assert_eq!(number(Some(&live(0))), Some(3));
        assert_eq!(number(None), Some(3));
        let taken_back = in_force(&versions[1..], None).map(|one| one.version);
        assert_eq!(taken_back, Some(1));
    }
}
