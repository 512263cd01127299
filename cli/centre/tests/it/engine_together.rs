//! What people and the centre do at one time.

use std::{sync::Arc, time::Duration};

use volcomp_centre::{
    issue::settle,
    records::{AlarmKind, Machine},
    rollout::{Phase, Rules, Step, Wish},
    store::Store,
};
use volcomp_fleet::{Acknowledgement, Kind, Outcome};

use crate::{
    gateway::{self, Told},
    shop::{Shop, manifest, soak, until},
    support::{condition, envelope, model, received, tell},
};

/// A person forbids correcting (`machine disable`: the registry first, then a manifest) while the centre is at its look with the machines
/// that it has read before.
#[test]
fn a_roll_out_does_not_enable_a_machine_that_was_just_disabled() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let rules = Rules {
            answer_s: 1000.0,
            ..soak(0.0)
        };
        let gateway = shop.gateway(0);
        let first = shop.roll_out(7, rules.clone());
        let name = shop.name(0).clone();
        until("it is over", || shop.rollout(first).phase.is_over()).await;
        gateway.1.abort();
        let new = model(8);
        shop.store.add_model(&new.model, &new.text).unwrap();
        // Another program writes for two seconds: the centre has read the machines and waits to issue.
        let path = shop.folder.path().join("centre.db");
        let (machine, key) = (shop.machines[0].0.clone(), shop.key.clone());
        let sha256 = new.model.sha256.clone();
        let by_hand = tokio::task::spawn_blocking(move || {
            let store = Store::open(&path).unwrap();
            let machines = [(machine.identity.machine.clone(), false)];
            store
                .begin_rollout(&sha256, &machines, rules, "anna")
                .unwrap();
            let raw = rusqlite::Connection::open(&path).unwrap();
            raw.busy_timeout(Duration::from_secs(30)).unwrap();
            raw.execute_batch("BEGIN IMMEDIATE").unwrap();
            std::thread::sleep(Duration::from_secs(2));
            let disabled = Machine {
                enable: false,
                ..machine.clone()
            };
            raw.execute(
                "UPDATE machines SET document = ?1 WHERE machine = ?2",
                rusqlite::params![
                    serde_json::to_string(&disabled).unwrap(),
                    machine.identity.machine.as_str()
                ],
            )
            .unwrap();
            raw.execute_batch("COMMIT").unwrap();
            settle(&store, &key, &machine.identity.machine, "anna")
                .unwrap()
                .map(|issued| issued.version)
        });
        let disabled = by_hand.await.unwrap();
        tokio::time::sleep(Duration::from_secs(4)).await;
        centre.end().await;
        let versions = shop.store.versions(&name).unwrap();
        let newest = &versions[0];
        assert!(
            !newest.enable,
            "anna forbade it with version {disabled:?}, and version {} of the roll-out allows it again",
            newest.version
        );
    });
}

/// Settings are sent again (`machine enable`) while the centre issues another model: the machine must not get the old one back.
#[test]
fn settings_that_are_sent_again_do_not_bring_the_old_model_back() {
    Shop::run(1, 1, async |shop| {
        let new = model(8);
        shop.store.add_model(&new.model, &new.text).unwrap();
        let name = shop.name(0).clone();
        let centre = shop.centre(&shop.url()).await;
        let gateway = shop.gateway(0);
        let id = shop.roll_out(7, soak(0.0));
        shop.until_done(id).await;
        gateway.1.abort();
        centre.end().await;
        let disabled = Machine {
            enable: false,
            ..shop.machines[0].0.clone()
        };
        shop.store.put_machine(&disabled, "anna").unwrap();
        let raw = shop.raw();
        let before = shop.issued(0).unwrap().version;
        raw.execute_batch("BEGIN IMMEDIATE").unwrap();
        let (key, machine, store) = (shop.key.clone(), name.clone(), Arc::clone(&shop.store));
        let other = std::thread::spawn(move || settle(&store, &key, &machine, "anna").unwrap());
        std::thread::sleep(Duration::from_secs(1));
        // What the centre does at that moment: version n + 1 of the new model.
        raw.execute(
        "INSERT INTO versions SELECT machine, version + 1, ?1, 1, 'x', document FROM versions WHERE machine = ?2 AND version = ?3",
        rusqlite::params![new.model.sha256, name.as_str(), i64::try_from(before).unwrap()],
    )
    .unwrap();
        raw.execute(
            "UPDATE desired SET version = version + 1, model = ?1 WHERE machine = ?2",
            rusqlite::params![new.model.sha256, name.as_str()],
        )
        .unwrap();
        raw.execute_batch("COMMIT").unwrap();
        let issued = other.join().unwrap().expect("other settings");
        assert_eq!(issued.version, before + 2);
        assert_eq!(
            issued.model, new.model.sha256,
            "the model before the roll-out is sent after the one of the roll-out"
        );
    });
}

/// Somebody stops a roll-out for good; within the same second, or while the centre is down, somebody else lets it go on, or
/// confirms a machine.
#[test]
fn a_stop_is_not_replaced_by_another_wish() {
    Shop::run(1, 1, async |shop| {
        let id = shop.roll_out(7, Rules::default());
        let machine = shop.name(0).clone();
        shop.store.wish(id, &Wish::Abort, "anna").unwrap();
        let confirm = Wish::Confirm {
            machine: machine.clone(),
            hash: "ab".into(),
        };
        let refused = shop.store.wish(id, &confirm, "bert").unwrap_err();
        assert!(
            refused.to_string().contains("roll-out 1 is over"),
            "{refused}"
        );
        shop.store.wish(id, &Wish::Resume, "bert").unwrap();
        let centre = shop.centre(&shop.url()).await;
        let rollout = || shop.rollout(id);
        until("it is over", || rollout().phase.is_over()).await;
        centre.end().await;
        assert_eq!(rollout().phase, Phase::Aborted { by: "anna".into() });
        assert_eq!(
            shop.issued(0),
            None,
            "anna stopped it for good, and something was issued"
        );
    });
}

/// Whoever changes what a machine is registered with (the page, `machine add`, another program): the machine is told, once.
#[test]
fn a_machine_is_told_what_it_is_registered_with_whoever_changed_it() {
    Shop::run(1, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let name = shop.name(0).clone();
        shop.roll_out(
            7,
            Rules {
                answer_s: 1000.0,
                ..soak(0.0)
            },
        );
        let newest = || shop.store.versions(&name).unwrap().into_iter().next();
        until("it has a model", || newest().is_some()).await;
        let registered = shop.machines[0].0.clone();
        let forbidden = Machine {
            enable: false,
            ..registered.clone()
        };
        shop.store.put_machine(&forbidden, "anna").unwrap();
        until("it is told", || {
            newest().is_some_and(|newest| !newest.enable)
        })
        .await;
        let slower = Machine {
            condition_s: Some(10),
            ..forbidden
        };
        shop.store.put_machine(&slower, "anna").unwrap();
        until("it is told", || {
            newest().is_some_and(|newest| newest.condition_s == Some(10) && !newest.enable)
        })
        .await;
        // What a manifest does not tell is nothing to be sent again.
        let noted = Machine {
            note: "near the door".into(),
            ..slower
        };
        shop.store.put_machine(&noted, "anna").unwrap();
        tokio::time::sleep(Duration::from_secs(3)).await;
        centre.end().await;
        let told = manifest(shop.issued(0).unwrap().value.as_bytes());
        assert_eq!(
            (told.version, told.enable, told.condition_s),
            (3, false, Some(10))
        );
    });
}

/// docs/src/fleet.md: what other settings are sent with, while a model waits for a person, is the model that is in force. The one
/// that waits is sent when it is confirmed, and not before.
#[test]
fn settings_do_not_send_a_model_that_waits_for_a_person() {
    Shop::run(1, 1, async |shop| {
        let (old, new) = (model(7), model(8));
        let name = shop.name(0).clone();
        let rollout = |id| shop.rollout(id);
        let versions = || shop.store.versions(&name).unwrap();
        let centre = shop.centre(&shop.url()).await;
        let gateway = shop.gateway(0);
        let rules = Rules {
            answer_s: 1000.0,
            ..soak(0.0)
        };
        let first = shop.roll_out(7, rules.clone());
        shop.until_done(first).await;
        gateway.1.abort();
        let second = shop.roll_out(8, rules);
        until("the new one is sent", || versions()[0].version == 2).await;
        centre.end().await;
        let answer = Acknowledgement {
            version: 2,
            value_sha256: versions()[0].value_sha256.clone(),
            outcome: Outcome::NeedsConfirmation {
                hash: "ab".into(),
                worst_um: "120.0".into(),
                worst_urad: String::new(),
            },
        };
        let message = envelope("b", 1, answer);
        let message = received("mill-0", Kind::Ack, 1, 1_800_000_000.0, &message);
        tell(&shop.store, &[message]);
        let centre = shop.centre(&shop.url()).await;
        let waits = || {
            matches!(
                rollout(second).targets[0].step,
                Step::NeedsConfirmation { .. }
            )
        };
        until("it waits for a person", waits).await;
        let mut gateway = None;
        for (version, enable) in [(3, false), (4, true)] {
            let change = |known: Option<Machine>| {
                let known = known.unwrap();
                Ok(Machine { enable, ..known })
            };
            shop.store.change_machine(&name, "anna", change).unwrap();
            shop.until_under_key(0, version).await;
            // The simulated gateway asks for no confirmation: it comes when what waits for one stands there no longer.
            gateway.get_or_insert_with(|| {
                let told = Told::default();
                tokio::spawn(gateway::run(shop.plan(0, "again"), told))
            });
            until("it is in force", || {
                let newest = versions()[0].clone();
                newest.version == version && newest.outcome == Some(Outcome::Activated)
            })
            .await;
            let newest = versions()[0].clone();
            assert_eq!(
                (newest.model, newest.enable),
                (old.model.sha256.clone(), enable)
            );
        }
        tokio::time::sleep(Duration::from_secs(2)).await;
        assert!(waits(), "it is taken for answered: {:?}", rollout(second));
        assert!(shop.is_open(AlarmKind::NeedsConfirmation));
        let confirm = Wish::Confirm {
            machine: name.clone(),
            hash: "ab".into(),
        };
        shop.store.wish(second, &confirm, "anna").unwrap();
        shop.until_done(second).await;
        let newest = versions()[0].clone();
        assert_eq!(
            (newest.model, newest.confirm),
            (new.model.sha256, Some("ab".into()))
        );
        gateway.unwrap().abort();
        centre.end().await;
    });
}

/// A fault that is told while a roll-out cannot be read is not forgotten: it counts when the roll-out can be read again.
#[test]
fn a_fault_is_not_dropped_by_a_look_that_fails() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateway = shop.gateway(0);
        let rules = soak(600.0);
        let id = shop.roll_out(7, rules);
        let soaks = || {
            let rollout = shop.rollout(id);
            matches!(rollout.targets[0].step, Step::Soaking { .. })
        };
        until("it is watched", soaks).await;
        let raw = shop.raw();
        let state: String = raw
            .query_row("SELECT state FROM rollouts", [], |row| row.get(0))
            .unwrap();
        raw.execute("UPDATE rollouts SET state = '{}'", []).unwrap();
        let told = |words: &str| {
            let open = shop.store.open_alarms().unwrap();
            open.iter()
                .any(|one| one.kind == AlarmKind::Rollout && one.text.contains(words))
        };
        until("it is told", || told("cannot go on")).await;
        let mut faulted = envelope("b", 1, condition(4.0));
        faulted.version = 1;
        faulted.body.state = "faulted".into();
        faulted.body.reasons = vec!["thermal runaway".into()];
        shop.tell(0, Kind::Condition, &faulted).await;
        tokio::time::sleep(Duration::from_secs(4)).await;
        raw.execute("UPDATE rollouts SET state = ?1", [state])
            .unwrap();
        shop.until_stopped(id, "thermal runaway").await;
        gateway.1.abort();
        centre.end().await;
    });
}
