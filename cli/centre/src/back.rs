//! The way back: the model that a machine has had in force before the one that it has now.

use volcomp_fleet::{MachineId, Outcome};

use crate::{
    clock::now_s,
    models::{NoModel, fits},
    records::{Live, Model, Version},
    rollout::{Rollout, Rules},
    store::{Store, StoreError},
};

/// The newest version whose model was in force before the one that the machine has now; `None`: there was no other.
///
/// `versions` begins with the newest. What the machine has now is what it tells, and where that is not known the newest version
/// that it has put in force.
pub fn before<'a>(versions: &'a [Version], live: Option<&Live>) -> Option<&'a Version> {
    let told = live.map(|live| live.version);
    let is_active = |version: &Version| version.outcome == Some(Outcome::Activated);
    let told = (versions.iter()).position(|version| Some(version.version) == told);
    let now = told.or_else(|| versions.iter().position(is_active))?;
    let model = &versions[now].model;
    versions[now..]
        .iter()
        .find(|version| is_active(version) && version.model != *model)
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
    None {
        /// The machine.
        machine: MachineId,
    },
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
    let live = store
        .live()?
        .into_iter()
        .find(|live| live.machine == *machine);
    let versions = store.versions(machine)?;
    let version = before(&versions, live.as_ref()).ok_or_else(none)?;
    let model = store.model(&version.model)?.ok_or_else(none)?;
    fits(&model, &known)?;
    let machines = [(machine.clone(), true)];
    let rollout = store.start_rollout(|id| {
        let (model, by) = (model.sha256.clone(), by.to_owned());
        Rollout::new(id, model, &machines, rules, by, now_s())
    })?;
    Ok((rollout, model))
}
