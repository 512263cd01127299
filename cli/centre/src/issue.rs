//! Issues manifests: each has a version higher than every earlier one, and is signed and stored in one transaction. The
//! engine sends stored manifests when the server is reachable.

use rusqlite::Connection;
use volcomp_fleet::{Desired, MachineId, Manifest, ModelRef, Outcome};

use crate::{
    Error,
    clock::now_s,
    keys::Key,
    models::fits,
    records::{Machine, Model, Version},
    store::{
        SignedValue, Store,
        machines::{live_of, machine_named},
        models::{
            add_version, change_version, clear_desired, model_of, newest, newest_version,
            next_version, text_of, versions_of,
        },
    },
    versions::{active_version, may_be_active},
};

#[derive(Clone, Debug)]
pub struct Order<'a> {
    pub machine: &'a Machine,
    pub model: &'a Model,
    pub text: &'a str,
    pub confirm: Option<String>,
    pub rollout: Option<u64>,
    pub by: &'a str,
}

pub(crate) fn issue(
    database: &Connection,
    key: &Key,
    order: &Order<'_>,
) -> Result<SignedValue, Error> {
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
    // The value is JSON, hence valid UTF-8.
    let value = String::from_utf8_lossy(&value).into_owned();
    add_version(database, &version, &value)?;
    Ok(SignedValue { machine: name.clone(), version: version.version, model: version.model, value })
}

/// Issues the active model of a machine again with the machine's current settings, after the machine was enabled or
/// disabled, or its intervals were changed.
fn reissue(
    database: &Connection,
    key: &Key,
    machine: &MachineId,
    by: &str,
) -> Result<SignedValue, Error> {
    // The settings are sent with the newest model under the machine's key if it is pending or active. If it was rejected or awaits confirmation,
    // or if the key has no value, they are sent with the active model instead. The version stays part of its roll-out, because a change of
    // settings does not validate its model.
    let under_key = newest(database, machine)?;
    let newest = newest_version(database, machine)?;
    let version = match newest {
        Some(newest) if may_be_active(&newest) => Some(Version {
            model: under_key.map_or_else(|| newest.model.clone(), |issued| issued.model),
            ..newest
        }),
        newest => {
            let versions = versions_of(database, machine)?;
            let live = live_of(database, machine)?;
            active_version(&versions, live.as_ref()).cloned().or(newest)
        }
    };
    let version = version.ok_or_else(|| Error::NoModelYet { machine: machine.clone() })?;
    issue_again(database, key, machine, &version.model, version.rollout, by)
}

fn issue_again(
    database: &Connection,
    key: &Key,
    name: &MachineId,
    sha256: &str,
    rollout: Option<u64>,
    by: &str,
) -> Result<SignedValue, Error> {
    let known = machine_named(database, name)?;
    let known = known.ok_or_else(|| Error::missing("machine", name))?;
    let model = model_of(database, sha256)?.ok_or_else(|| Error::missing("model", sha256))?;
    let text = text_of(database, sha256)?.ok_or_else(|| Error::missing("model", sha256))?;
    let order = Order { machine: &known, model: &model, text: &text, confirm: None, rollout, by };
    issue(database, key, &order)
}

/// Withdraws a roll-out's version that is not active on a machine: issues the previous model again, or clears the
/// machine's key if there is no previous model.
pub(crate) fn withdraw(
    database: &Connection,
    key: &Key,
    machine: &MachineId,
    rollout: u64,
) -> Result<(), Error> {
    let is_of_rollout = |version: &Version| version.rollout == Some(rollout);
    let newest = newest_version(database, machine)?;
    let must_withdraw =
        |newest: &Version| is_of_rollout(newest) && newest.outcome != Some(Outcome::Activated);
    if !newest.as_ref().is_some_and(must_withdraw) {
        return Ok(());
    }
    let versions = versions_of(database, machine)?;
    for version in versions.iter().filter(|version| is_of_rollout(version)) {
        let withdrawn = Version { withdrawn: true, ..version.clone() };
        change_version(database, &withdrawn)?;
    }
    // Exclude versions that were rejected or wait for confirmation.
    let before: Vec<Version> = (versions.into_iter())
        .filter(|version| !is_of_rollout(version) && may_be_active(version))
        .collect();
    let live = live_of(database, machine)?;
    let issued = match active_version(&before, live.as_ref()).or(before.first()) {
        Some(before) => {
            let (model, rollout) = (&before.model, before.rollout);
            issue_again(database, key, machine, model, rollout, "centre")
        }
        None => Err(Error::NoModelYet { machine: machine.clone() }),
    };
    match issued {
        Ok(_) => Ok(()),
        Err(error) if error.is_of_database() => Err(error),
        // There was no earlier model, or it no longer fits the machine.
        Err(_) => clear_desired(database, machine),
    }
}

/// True if the settings in the newest manifest differ from the registered ones.
pub fn differs(machine: &Machine, newest: &Version) -> bool {
    (machine.enable, machine.condition_s, machine.telemetry_s)
        != (newest.enable, newest.condition_s, newest.telemetry_s)
}

/// Issues the model of a machine again if the settings in its newest manifest differ from the registered ones. `None` if they agree.
pub fn settle(
    store: &Store,
    key: &Key,
    machine: &MachineId,
    by: &str,
) -> Result<Option<SignedValue>, Error> {
    store.write(|database| {
        let known = machine_named(database, machine)?;
        let known = known.ok_or_else(|| Error::missing("machine", machine))?;
        // A machine whose key holds no value continues with its active version.
        let newest = if let Some(newest) = newest_version(database, machine)? {
            Some(newest)
        } else {
            let versions = versions_of(database, machine)?;
            active_version(&versions, live_of(database, machine)?.as_ref()).cloned()
        };
        let newest = newest.ok_or_else(|| Error::NoModelYet { machine: machine.clone() })?;
        if !differs(&known, &newest) {
            return Ok(None);
        }
        reissue(database, key, machine, by).map(Some)
    })
}

#[cfg(test)]
pub(crate) use tests::Fixture;

#[cfg(test)]
mod tests {
    use ed25519_dalek::SigningKey;
    use volcomp_fleet::Identity;
    use volcomp_vocabulary::AxisName;

    use super::*;
    use crate::{
        models::NewModel,
        records::{Live, Origin},
    };

    pub(crate) struct Fixture {
        _folder: tempfile::TempDir,
        pub(crate) store: Store,
        key: Key,
        machine: Machine,
    }

    impl Fixture {
        pub(crate) fn new() -> Self {
            let folder = tempfile::tempdir().expect("writable");
            let store = Store::open(&folder.path().join("centre.db")).expect("a store");
            let identity = Identity {
                site: "berlin".parse().expect("a name"),
                machine: "mill-1".parse().expect("a name"),
            };
            let axes = vec![AxisName::X, AxisName::Y, AxisName::Z];
            let machine = Machine::new(identity, "1".into(), "w X' b Y Z t".into(), axes);
            store.put_machine(&machine, "anna").expect("stored");
            let key = Key { name: "main".to_owned(), key: SigningKey::from_bytes(&[7; 32]) };
            Self { _folder: folder, store, key, machine }
        }

        pub(crate) fn name(&self) -> &MachineId {
            &self.machine.identity.machine
        }

        #[expect(clippy::needless_pass_by_value, reason = "tests build the outcome in the call")]
        pub(crate) fn issue(&self, number: u32, rollout: u64, outcome: Option<Outcome>) -> String {
            let text = format!(
                "name = \"mill\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 500.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 300.0]\n[errors]\nEC0Y = {number}.0\n"
            );
            let origin = Origin::File { name: String::new() };
            let new = NewModel::of_text(text, "mill.toml", origin, "anna").expect("a model");
            self.store.add_model(&new.model, &new.text).expect("stored");
            let issued = self.store.write(|database| {
                let order = Order {
                    machine: &self.machine,
                    model: &new.model,
                    text: &new.text,
                    confirm: None,
                    rollout: Some(rollout),
                    by: "anna",
                };
                issue(database, &self.key, &order)?;
                let newest = newest_version(database, self.name())?.expect("it was issued");
                let answered_s = outcome.is_some().then_some(1.0);
                let answered = Version { outcome: outcome.clone(), answered_s, ..newest };
                change_version(database, &answered)
            });
            issued.expect("issued");
            new.model.sha256
        }

        fn withdraw(&self, rollout: u64) {
            let store = &self.store;
            let done = store.write(|database| withdraw(database, &self.key, self.name(), rollout));
            done.expect("withdrawn");
        }

        fn under_key(&self) -> Option<(u64, String)> {
            let issued = self.store.issued(self.name()).expect("a store");
            issued.map(|issued| (issued.version, issued.model))
        }
    }

    fn refused() -> Outcome {
        let why = "its axes".to_owned();
        Outcome::Refused { why }
    }

    #[test]
    fn a_rejected_model_does_not_return_on_withdrawal() {
        let fixture = Fixture::new();
        let old = fixture.issue(1, 1, Some(Outcome::Activated));
        fixture.issue(2, 2, Some(refused()));
        fixture.issue(3, 3, None);
        fixture.withdraw(3);
        assert_eq!(fixture.under_key(), Some((4, old)));
        let other = Fixture::new();
        other.issue(1, 1, Some(refused()));
        other.issue(2, 2, None);
        other.withdraw(2);
        assert_eq!(other.under_key(), None);
    }

    #[test]
    fn settings_are_sent_with_the_restored_model() {
        let fixture = Fixture::new();
        let old = fixture.issue(1, 1, Some(Outcome::Activated));
        fixture.issue(2, 2, None);
        fixture.withdraw(2);
        // The machine has activated the withdrawn version and has not yet reverted to the old one.
        let live = Live::new(fixture.name().clone(), 1.0, 2);
        fixture.store.put_live(&[live]).expect("stored");
        let again = |database: &Connection| reissue(database, &fixture.key, fixture.name(), "anna");
        let issued = fixture.store.write(again).expect("issued");
        assert_eq!((issued.version, issued.model), (4, old));
    }

    /// The key of the machine has no value, and the withdrawn version is active: changed settings
    /// still reach the machine.
    #[test]
    fn a_machine_without_a_value_can_be_disabled() {
        let fixture = Fixture::new();
        let settle = || settle(&fixture.store, &fixture.key, fixture.name(), "anna");
        let new = fixture.issue(1, 1, None);
        fixture.withdraw(1);
        let disabled = Machine { enable: false, ..fixture.machine.clone() };
        fixture.store.put_machine(&disabled, "anna").expect("stored");
        assert!(matches!(settle(), Err(Error::NoModelYet { .. })));
        let live = Live::new(fixture.name().clone(), 1.0, 1);
        fixture.store.put_live(&[live]).expect("stored");
        let issued = settle().expect("issued").expect("other settings");
        assert_eq!((issued.version, issued.model), (2, new));
        assert!(settle().expect("a store").is_none());
    }
}
