//! The way back: the model that a machine has had in force before the one that it has now.

use std::collections::BTreeSet;

use volcomp_fleet::{MachineId, Outcome};

use crate::{
    drift::in_force,
    models::{NoModel, fits},
    records::{Live, Model, Version},
    rollout::{Rollout, Rules},
    store::{Store, StoreError},
};

/// The newest version whose model was in force before the one that the machine has now; `None`: there was no other.
///
/// `versions` begins with the newest. What was taken back is none, nor what is of a roll-out that was `broken_off` and that nobody
/// has decided to keep.
pub fn before<'a>(
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
) -> Result<BTreeSet<u64>, StoreError> {
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

/// Why there is no way back.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NoWayBack {
    /// The store, or a roll-out that is not over.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The model of before fits the machine no longer.
    #[error(transparent)]
    Model(#[from] NoModel),
    /// There is no such machine, or it has had one model alone.
    #[error("{machine}: found no model that it has had in force before the one that it has now")]
    None { machine: MachineId },
}

/// The version whose model a machine can be given back; `None`: it has had no other in force, or what it had was broken off.
///
/// # Errors
/// The database cannot be read.
pub fn way(
    store: &Store,
    machine: &MachineId,
    live: Option<&Live>,
) -> Result<Option<Version>, StoreError> {
    let versions = store.versions(machine)?;
    let broken_off = broken_off(store, machine, &versions)?;
    Ok(before(&versions, live, &broken_off).cloned())
}

/// Starts a roll-out of that model to the machine: it gets a version that is higher than all before, and is watched as with any
/// other.
///
/// # Errors
/// There is none, or the machine has its turn in a roll-out that is not over.
pub fn start(
    store: &Store,
    machine: &MachineId,
    rules: Rules,
    by: &str,
) -> Result<(Rollout, Model), NoWayBack> {
    let none = || NoWayBack::None {
        machine: machine.clone(),
    };
    let known = store.machine(machine)?.ok_or_else(none)?;
    let live = store.live_of(machine)?;
    let version = way(store, machine, live.as_ref())?.ok_or_else(none)?;
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
