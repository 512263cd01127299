//! The active version of a machine, and the previous version whose model the machine can return to.

use std::collections::{BTreeMap, BTreeSet};

use volcomp_fleet::{MachineId, Outcome};

use crate::{
    Error,
    models::{due_days, fits},
    records::{Live, Machine, Model, Version},
    rollout::{Rollout, Rules},
    store::Store,
};

/// True if the version may be active: it was neither rejected nor withdrawn, and does not wait for confirmation.
pub(crate) fn may_be_active(version: &Version) -> bool {
    !version.withdrawn
        && !matches!(
            version.outcome,
            Some(Outcome::Refused { .. } | Outcome::NeedsConfirmation { .. })
        )
}

/// The active version by [`active_version`], for a machine whose `newest` version is known. Other versions are read
/// only if the machine does not report `newest`.
pub(crate) fn load_active_version(
    store: &Store,
    machine: &MachineId,
    newest: Option<&Version>,
    live: Option<&Live>,
) -> Result<Option<Version>, Error> {
    let reported = live.map_or(0, |live| live.version);
    match newest {
        Some(newest) if newest.version == reported => Ok(Some(newest.clone())),
        None if reported == 0 => Ok(None),
        _ => Ok(active_version(&store.versions(machine)?, live).cloned()),
    }
}

/// The active version: the version that the machine reports. If the reported version is unknown, or a later outcome
/// states that a newer version is active: the newest version that was activated and not withdrawn. `versions` begins
/// with the newest.
pub fn active_version<'a>(versions: &'a [Version], live: Option<&Live>) -> Option<&'a Version> {
    let reported = live.and_then(|live| {
        let mut each = versions.iter();
        each.find(|version| version.version == live.version)
    });
    let told_s = live.and_then(Live::made).map(|made| made.at_s);
    let is_active = |version: &&Version| {
        let is_newer = reported.is_none_or(|reported| {
            // An outcome may arrive before the next condition.
            let is_later =
                version.answered_s.zip(told_s).is_some_and(|(at, reported)| at > reported);
            version.version > reported.version && is_later
        });
        is_newer && !version.withdrawn && version.outcome == Some(Outcome::Activated)
    };
    versions.iter().find(is_active).or(reported)
}

/// Checksum of the active model, for a machine whose `newest` version is known; older versions are read only if needed.
/// For a machine that has reported nothing: the model of the newest version that may be active.
fn load_active_model(
    store: &Store,
    newest: &Version,
    live: Option<&Live>,
) -> Result<Option<String>, Error> {
    if live.is_some_and(|live| live.version == newest.version) {
        return Ok(Some(newest.model.clone()));
    }
    let versions = store.versions(&newest.machine)?;
    let may_be = || versions.iter().find(|version| may_be_active(version));
    let version = active_version(&versions, live).or_else(may_be);
    Ok(version.map(|version| version.model.clone()))
}

/// Days since a machine's calibration became due; see [`due_days`]. A calibration that was rejected
/// or waits for confirmation does not count. `models` holds the models of the newest versions; an
/// older model is read from the store.
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
    let Some(sha256) = load_active_model(store, newest, live)? else {
        return Ok(None);
    };
    if let Some(model) = models.get(&sha256) {
        return Ok(due_days(machine, model, now_s));
    }
    let model = store.model_with(&sha256)?;
    Ok(model.and_then(|model| due_days(machine, &model, now_s)))
}

/// The newest version whose model was active before the present one; `None` if no other model was.
///
/// `versions` begins with the newest. Excluded are withdrawn versions, and versions of the roll-outs in `broken_off`.
fn before<'a>(
    versions: &'a [Version],
    live: Option<&Live>,
    broken_off: &BTreeSet<u64>,
) -> Option<&'a Version> {
    let now = active_version(versions, live)?;
    versions.iter().find(|version| {
        version.version < now.version
            && version.outcome == Some(Outcome::Activated)
            && version.model != now.model
            && !version.withdrawn
            && !version.rollout.is_some_and(|id| broken_off.contains(&id))
    })
}

/// Stopped or aborted roll-outs of these versions of a machine, except those whose model the user decided to keep.
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

/// The version that a machine can return to; `None` if no other model was active before, or only models of stopped or
/// aborted roll-outs were.
pub(crate) fn way_back(
    store: &Store,
    machine: &MachineId,
    live: Option<&Live>,
) -> Result<Option<Version>, Error> {
    let versions = store.versions(machine)?;
    let broken_off = broken_off(store, machine, &versions)?;
    Ok(before(&versions, live, &broken_off).cloned())
}

/// Starts a roll-out that returns the machine to its previous model. The model gets a version higher than all earlier
/// ones, and the machine is observed as in any roll-out.
///
/// # Errors
/// The machine had no earlier model, or is in an open roll-out.
pub fn start_way_back(
    store: &Store,
    machine: &MachineId,
    rules: Rules,
    by: &str,
) -> Result<(Rollout, Model), Error> {
    let none = || Error::NoWayBack { machine: machine.clone() };
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
    fn a_withdrawn_version_is_no_way_back() {
        let versions =
            [version(3, "M0", 1, false), version(2, "M1", 2, true), version(1, "M0", 1, false)];
        assert_eq!(found(&versions, Some(&live(3)), &[]), None);
        assert_eq!(found(&versions, None, &[]), None);
        // The machine still runs the withdrawn version.
        assert_eq!(found(&versions, Some(&live(2)), &[]), Some(1));
    }

    #[test]
    fn a_broken_off_version_is_no_way_back_unless_kept() {
        let versions =
            [version(3, "M2", 3, false), version(2, "M1", 2, false), version(1, "M0", 1, false)];
        assert_eq!(found(&versions, None, &[2]), Some(1));
        assert_eq!(found(&versions, None, &[]), Some(2));
    }

    #[test]
    fn the_reported_version_is_active() {
        let versions =
            [version(3, "M0", 1, false), version(2, "M1", 2, true), version(1, "M0", 1, false)];
        let number = |live: Option<&Live>| active_version(&versions, live).map(|one| one.version);
        assert_eq!(number(Some(&live(2))), Some(2));
        assert_eq!(number(Some(&live(0))), Some(3));
        assert_eq!(number(None), Some(3));
        let taken_back = active_version(&versions[1..], None).map(|one| one.version);
        assert_eq!(taken_back, Some(1));
    }
}
