//! Issuing a manifest: a version that is higher than every one before, signed, and stored with its value in one transaction.
//! From the store it goes to the server, now or as soon as that is there.

use volcomp_fleet::{Desired, MachineId, Manifest, ModelRef, Outcome};

use crate::{
    clock::now_s,
    drift::{in_force, may_be_in_force},
    keys::Key,
    models::{NoModel, fits},
    records::{Machine, Model, Version},
    store::{
        Database, Issued, Store, StoreError,
        machines::machine_named,
        models::{
            add_version, change_version, clear_desired, model_of, newest, newest_version,
            next_version, text_of, versions_of,
        },
    },
};

/// Why nothing is issued.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum NotIssued {
    /// The store refuses.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The model does not fit the machine.
    #[error(transparent)]
    Model(#[from] NoModel),
    /// There is no such machine or model.
    #[error("found no {what} {name}")]
    Missing {
        /// The kind of thing.
        what: &'static str,
        /// Its name.
        name: String,
    },
    /// The machine has no model yet.
    #[error("{machine} has no model yet: expected a roll-out first")]
    NoModelYet {
        /// The machine.
        machine: MachineId,
    },
    /// The manifest cannot be written.
    #[error(transparent)]
    Manifest(#[from] volcomp_fleet::NotADesired),
}

/// What is to be issued.
#[derive(Clone, Debug)]
pub struct Order<'a> {
    /// For this machine.
    pub machine: &'a Machine,
    /// This model.
    pub model: &'a Model,
    /// With this text.
    pub text: &'a str,
    /// The hash that a person has confirmed.
    pub confirm: Option<String>,
    /// In this roll-out.
    pub rollout: Option<u64>,
    /// By this person.
    pub by: &'a str,
}

/// Issues a manifest within a transaction.
pub(crate) fn issue(
    database: &mut dyn Database,
    key: &Key,
    order: &Order<'_>,
) -> Result<Issued, NotIssued> {
    let Order { machine, model, .. } = order;
    fits(model, machine)?;
    let name = &machine.identity.machine;
    let now_s = now_s();
    let manifest = Manifest {
        machine: name.clone(),
        serial: machine.serial.clone(),
        version: next_version(database, name)?,
        axes: machine.axes.clone(),
        model: ModelRef::of(order.text.as_bytes()),
        enable: machine.enable,
        confirm: order.confirm.clone(),
        condition_s: machine.condition_s,
        telemetry_s: machine.telemetry_s,
        issued: format!("{now_s:.0} s since 1970, {}", order.by),
    };
    let value = Desired::sign(&manifest, order.text, &key.key)?.bytes()?;
    let version = Version {
        machine: name.clone(),
        version: manifest.version,
        model: model.sha256.clone(),
        enable: manifest.enable,
        confirm: manifest.confirm,
        condition_s: manifest.condition_s,
        telemetry_s: manifest.telemetry_s,
        value_sha256: ModelRef::of(&value).sha256,
        rollout: order.rollout,
        issued_s: now_s,
        by: order.by.to_owned(),
        outcome: None,
        answered_s: None,
        withdrawn: false,
    };
    // It is JSON, so it is a text.
    let value = String::from_utf8_lossy(&value).into_owned();
    add_version(database, &version, &value)?;
    Ok(Issued {
        machine: name.clone(),
        version: version.version,
        model: version.model,
        value,
    })
}

/// Issues the model that a machine has in force once more, with the settings that it has now: after it was enabled or disabled, or
/// its intervals were changed. The running centre sends it within a second.
///
/// # Errors
/// There is no such machine, or it has no model.
pub fn reissue(
    store: &Store,
    key: &Key,
    machine: &MachineId,
    by: &str,
) -> Result<Issued, NotIssued> {
    store.write_or(|database| reissue_in(database, key, machine, by))
}

/// The same within a transaction: the machine and its model are those that it has in this transaction.
pub(crate) fn reissue_in(
    database: &mut dyn Database,
    key: &Key,
    machine: &MachineId,
    by: &str,
) -> Result<Issued, NotIssued> {
    let last = newest(database, machine)?.ok_or_else(|| NotIssued::NoModelYet {
        machine: machine.clone(),
    })?;
    let newest = newest_version(database, machine)?;
    // A model that was refused, or that waits for a person, is not sent again by the way: the settings go with the one that is in
    // force. It stays the model of its roll-out: settings make nothing good.
    if !newest.as_ref().is_none_or(may_be_in_force) {
        let versions = versions_of(database, machine)?;
        if let Some(version) = in_force(&versions) {
            let (model, rollout) = (&version.model, version.rollout);
            return issue_again(database, key, machine, model, rollout, by);
        }
    }
    let rollout = newest.and_then(|version| version.rollout);
    issue_again(database, key, machine, &last.model, rollout, by)
}

/// Issues a model that the machine was to have before.
fn issue_again(
    database: &mut dyn Database,
    key: &Key,
    name: &MachineId,
    sha256: &str,
    rollout: Option<u64>,
    by: &str,
) -> Result<Issued, NotIssued> {
    let known = machine_named(database, name)?;
    let known = known.ok_or_else(|| missing("machine", name.as_str()))?;
    let model = model_of(database, sha256)?.ok_or_else(|| missing("model", sha256))?;
    let text = text_of(database, sha256)?.ok_or_else(|| missing("model", sha256))?;
    let order = Order {
        machine: &known,
        model: &model,
        text: &text,
        confirm: None,
        rollout,
        by,
    };
    issue(database, key, &order)
}

/// Takes back what a roll-out has issued for a machine that does not have it in force: the model that it was to have before is
/// issued once more; where there was none, nothing stands under its key.
pub(crate) fn withdraw(
    database: &mut dyn Database,
    key: &Key,
    machine: &MachineId,
    rollout: u64,
) -> Result<(), StoreError> {
    let of_it = |version: &Version| version.rollout == Some(rollout);
    let newest = newest_version(database, machine)?;
    let is_to_be = |newest: &Version| of_it(newest) && newest.outcome != Some(Outcome::Activated);
    if !newest.as_ref().is_some_and(is_to_be) {
        return Ok(());
    }
    let versions = versions_of(database, machine)?;
    for version in versions.iter().filter(|version| of_it(version)) {
        let withdrawn = Version {
            withdrawn: true,
            ..version.clone()
        };
        change_version(database, &withdrawn)?;
    }
    let mut versions = versions.into_iter();
    let before = versions.find(|version| !of_it(version) && !version.withdrawn);
    let issued = match before {
        Some(before) => {
            let (model, rollout) = (&before.model, before.rollout);
            issue_again(database, key, machine, model, rollout, "centre")
        }
        None => Err(NotIssued::NoModelYet {
            machine: machine.clone(),
        }),
    };
    match issued {
        Ok(_) => Ok(()),
        Err(NotIssued::Store(error)) => Err(error),
        // It has had none, or one that fits it no longer.
        Err(_) => clear_desired(database, machine),
    }
}

/// Whether the newest manifest of a machine tells it other settings than those that it is registered with.
pub fn differs(machine: &Machine, newest: &Version) -> bool {
    (machine.enable, machine.condition_s, machine.telemetry_s)
        != (newest.enable, newest.condition_s, newest.telemetry_s)
}

/// Issues the model of a machine once more where its newest manifest tells other settings than those that it is registered
/// with. `None`: it tells them already.
///
/// # Errors
/// There is no such machine, or it has no model.
pub fn settle(
    store: &Store,
    key: &Key,
    machine: &MachineId,
    by: &str,
) -> Result<Option<Issued>, NotIssued> {
    store.write_or(|database| {
        let known = machine_named(database, machine)?;
        let known = known.ok_or_else(|| missing("machine", machine.as_str()))?;
        let newest = newest_version(database, machine)?;
        let newest = newest.ok_or_else(|| NotIssued::NoModelYet {
            machine: machine.clone(),
        })?;
        if !differs(&known, &newest) {
            return Ok(None);
        }
        reissue_in(database, key, machine, by).map(Some)
    })
}

/// Something is not there.
pub(crate) fn missing(what: &'static str, name: &str) -> NotIssued {
    NotIssued::Missing {
        what,
        name: name.to_owned(),
    }
}
