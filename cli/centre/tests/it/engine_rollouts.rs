//! Roll-outs end to end: concurrent actions of users and the centre, stops and aborts.

use std::{
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use volcomp_centre::{
    issue::settle,
    records::{AlarmKind, Machine},
    rollout::{Phase, Rules, Step, UserRequest},
    store::Store,
    versions::start_way_back,
};
use volcomp_fleet::{Acknowledgement, Kind, MachineId, Outcome};

use crate::{
    gateway::{self, GatewayState},
    shop::{Shop, manifest, soak, until},
    support::{condition, envelope, model, received, tell},
};

/// A user disables a machine during a pass that has already read the old record. The roll-out does not enable the
/// machine again.
#[test]
fn a_rollout_does_not_enable_a_machine_that_was_just_disabled() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let rules = Rules { answer_s: 1000.0, ..soak(0.0) };
        let gateway = shop.gateway(0);
        let first = shop.roll_out(7, rules.clone());
        let name = shop.name(0).clone();
        until("it is over", || shop.rollout(first).phase.is_over()).await;
        gateway.1.abort();
        let new = model(8);
        shop.store.add_model(&new.model, &new.text).unwrap();
        // Another program writes for two seconds, so that the centre has read the machines and waits before it issues.
        let path = shop.folder.path().join("centre.db");
        let (machine, key) = (shop.machines[0].0.clone(), shop.key.clone());
        let sha256 = new.model.sha256.clone();
        let by_hand = tokio::task::spawn_blocking(move || {
            let store = Store::open(&path).unwrap();
            let machines = [(machine.identity.machine.clone(), false)];
            store.begin_rollout(&sha256, &machines, rules, "anna").unwrap();
            let raw = rusqlite::Connection::open(&path).unwrap();
            raw.busy_timeout(Duration::from_secs(30)).unwrap();
            raw.execute_batch("BEGIN IMMEDIATE").unwrap();
            std::thread::sleep(Duration::from_secs(2));
            let disabled = Machine { enable: false, ..machine.clone() };
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

/// `machine enable` sends the settings again while the centre issues another model. The old model is not restored.
#[test]
fn reissued_settings_do_not_restore_the_old_model() {
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
        let disabled = Machine { enable: false, ..shop.machines[0].0.clone() };
        shop.store.put_machine(&disabled, "anna").unwrap();
        let raw = shop.raw();
        let before = shop.issued(0).unwrap().version;
        raw.execute_batch("BEGIN IMMEDIATE").unwrap();
        let (key, machine, store) = (shop.key.clone(), name.clone(), Arc::clone(&shop.store));
        let other = std::thread::spawn(move || settle(&store, &key, &machine, "anna").unwrap());
        std::thread::sleep(Duration::from_secs(1));
        // Meanwhile the centre issues version n + 1 with the new model.
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

/// A user aborts a roll-out. Another user resumes it or confirms a machine within the same second, or while the centre
/// is down. The roll-out stays aborted.
#[test]
fn an_abort_is_not_replaced_by_another_request() {
    Shop::run(1, 1, async |shop| {
        let id = shop.roll_out(7, Rules::default());
        let machine = shop.name(0).clone();
        shop.store.request_rollout_change(id, &UserRequest::Abort, "anna").unwrap();
        let confirm = UserRequest::Confirm { machine: machine.clone(), hash: "ab".into() };
        let refused = shop.store.request_rollout_change(id, &confirm, "bert").unwrap_err();
        assert!(refused.to_string().contains("roll-out 1 is over"), "{refused}");
        shop.store.request_rollout_change(id, &UserRequest::Resume, "bert").unwrap();
        let centre = shop.centre(&shop.url()).await;
        let rollout = || shop.rollout(id);
        until("it is over", || rollout().phase.is_over()).await;
        centre.end().await;
        assert_eq!(rollout().phase, Phase::Aborted { by: "anna".into() });
        assert_eq!(shop.issued(0), None, "anna stopped it for good, and something was issued");
    });
}

/// Changed settings are sent to the machine once, whether changed by the web interface, `machine add` or another program.
#[test]
fn changed_settings_are_sent_once_whatever_changed_them() {
    Shop::run(1, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let name = shop.name(0).clone();
        shop.roll_out(7, Rules { answer_s: 1000.0, ..soak(0.0) });
        let newest = || shop.store.versions(&name).unwrap().into_iter().next();
        until("it has a model", || newest().is_some()).await;
        let registered = shop.machines[0].0.clone();
        let forbidden = Machine { enable: false, ..registered.clone() };
        shop.store.put_machine(&forbidden, "anna").unwrap();
        until("the settings are sent", || newest().is_some_and(|newest| !newest.enable)).await;
        let slower = Machine { condition_s: Some(10), ..forbidden };
        shop.store.put_machine(&slower, "anna").unwrap();
        until("the settings are sent", || {
            newest().is_some_and(|newest| newest.condition_s == Some(10) && !newest.enable)
        })
        .await;
        // A field that is not in the manifest causes no new version.
        let noted = Machine { note: "near the door".into(), ..slower };
        shop.store.put_machine(&noted, "anna").unwrap();
        tokio::time::sleep(Duration::from_secs(3)).await;
        centre.end().await;
        let reported = manifest(shop.issued(0).unwrap().value.as_bytes());
        assert_eq!((reported.version, reported.enable, reported.condition_s), (3, false, Some(10)));
    });
}

/// docs/src/fleet.md: while a model waits for confirmation, changed settings are sent with the active model. The waiting model is sent
/// when confirmed, not before.
#[test]
fn settings_do_not_send_an_unconfirmed_model() {
    Shop::run(1, 1, async |shop| {
        let (old, new) = (model(7), model(8));
        let name = shop.name(0).clone();
        let rollout = |id| shop.rollout(id);
        let versions = || shop.store.versions(&name).unwrap();
        let centre = shop.centre(&shop.url()).await;
        let gateway = shop.gateway(0);
        let rules = Rules { answer_s: 1000.0, ..soak(0.0) };
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
                differences: Vec::new(),
            },
        };
        let message = envelope("b", 1, answer);
        let message = received("mill-0", Kind::Ack, 1, 1_800_000_000.0, &message);
        tell(&shop.store, &[message]);
        let centre = shop.centre(&shop.url()).await;
        let waits = || matches!(rollout(second).targets[0].step, Step::NeedsConfirmation { .. });
        until("it waits for confirmation", waits).await;
        let mut gateway = None;
        for (version, enable) in [(3, false), (4, true)] {
            let change = |known: Option<Machine>| {
                let known = known.unwrap();
                Ok(Machine { enable, ..known })
            };
            shop.store.change_machine(&name, "anna", change).unwrap();
            shop.until_under_key(0, version).await;
            // The simulated gateway needs no confirmation, so it starts only after the waiting value was replaced.
            gateway.get_or_insert_with(|| {
                let reported = GatewayState::default();
                tokio::spawn(gateway::run(shop.plan(0, "again"), reported))
            });
            until("it is active", || {
                let newest = versions()[0].clone();
                newest.version == version && newest.outcome == Some(Outcome::Activated)
            })
            .await;
            let newest = versions()[0].clone();
            assert_eq!((newest.model, newest.enable), (old.model.sha256.clone(), enable));
        }
        tokio::time::sleep(Duration::from_secs(2)).await;
        assert!(waits(), "it is taken for answered: {:?}", rollout(second));
        assert!(shop.is_open(AlarmKind::NeedsConfirmation));
        let confirm = UserRequest::Confirm { machine: name.clone(), hash: "ab".into() };
        shop.store.request_rollout_change(second, &confirm, "anna").unwrap();
        shop.until_done(second).await;
        let newest = versions()[0].clone();
        assert_eq!((newest.model, newest.confirm), (new.model.sha256, Some("ab".into())));
        gateway.unwrap().abort();
        centre.end().await;
    });
}

/// A fault reported while a roll-out is unreadable still counts when the roll-out can be read.
#[test]
fn a_fault_is_not_lost_by_a_failed_pass() {
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
        let state: String =
            raw.query_row("SELECT state FROM rollouts", [], |row| row.get(0)).unwrap();
        raw.execute("UPDATE rollouts SET state = '{}'", []).unwrap();
        let reported = |words: &str| {
            let open = shop.store.open_alarms().unwrap();
            open.iter().any(|one| one.kind == AlarmKind::Rollout && one.text.contains(words))
        };
        until("an alarm is raised", || reported("cannot proceed")).await;
        let mut faulted = envelope("b", 1, condition(4.0));
        faulted.version = 1;
        faulted.body.state = "faulted".into();
        faulted.body.reasons = vec!["thermal runaway".into()];
        shop.tell(0, Kind::Condition, &faulted).await;
        tokio::time::sleep(Duration::from_secs(4)).await;
        raw.execute("UPDATE rollouts SET state = ?1", [state]).unwrap();
        shop.until_stopped(id, "thermal runaway").await;
        gateway.1.abort();
        centre.end().await;
    });
}

/// A machine has another model under the version of the roll-out, because the database is an older copy: it is not observed with the new model.
#[test]
fn another_model_under_the_same_version_is_not_observed() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let id = shop.roll_out(7, Rules { answer_s: 10.0, ..soak(0.0) });
        until("it is sent", || shop.issued(0).is_some()).await;
        let mut other = envelope("b", 1, condition(4.0));
        other.version = 1;
        other.model = model(8).model.checksum;
        shop.tell(0, Kind::Condition, &other).await;
        shop.until_stopped(id, "no answer in time").await;
        centre.end().await;
    });
}

fn is_suspect(shop: &Shop) -> bool {
    let open = shop.store.open_alarms().unwrap();
    open.iter().any(|alarm| {
        let of = alarm.machine.as_ref().map(MachineId::as_str);
        alarm.kind == AlarmKind::Suspect && of == Some("mill-0")
    })
}

/// Two machines are offline when a roll-out stops. One machine gets its previous model again under a higher version,
/// never the stopped model. The key of the other, which has no previous model, is emptied. A machine with the stopped
/// model is suspect until its previous model is active.
#[test]
fn an_offline_machine_does_not_accept_a_stopped_rollout() {
    Shop::run(1, 3, async |shop| {
        let (old, new) = (model(7), model(8));
        let centre = shop.centre(&shop.url()).await;
        let plan = shop.plan(0, "run-0");
        let residual = Arc::clone(&plan.residual_um);
        let staying = GatewayState::default();
        let stays = tokio::spawn(gateway::run(plan, staying.clone()));
        let leaves = shop.gateway(1);
        let quick = Rules { soak_s: 0.0, waves: vec![100], ..Rules::default() };
        let first = shop.roll_out_to(7, &[0, 1], quick);
        let rollout = |id| shop.rollout(id);
        shop.until_done(first).await;
        leaves.1.abort();
        shop.store.add_model(&new.model, &new.text).unwrap();
        let all: Vec<_> = (shop.machines.iter())
            .map(|(machine, _)| (machine.identity.machine.clone(), true))
            .collect();
        let rules = Rules { soak_s: 600.0, answer_s: 600.0, ..Rules::default() };
        let begun = shop.store.begin_rollout(&new.model.sha256, &all, rules, "anna");
        let second = begun.unwrap().id;
        let issued = |place: usize| shop.store.issued(&all[place].0).unwrap();
        until("it is sent", || issued(2).is_some() && issued(1).unwrap().version == 2).await;
        until("one has it", || staying.version() == 2).await;
        assert!(!is_suspect(shop));
        *residual.lock().unwrap() = 400.0;
        shop.until_stopped(second, "").await;
        until("it is taken back", || issued(2).is_none() && issued(1).unwrap().version == 3).await;
        let again = manifest(issued(1).unwrap().value.as_bytes());
        assert_eq!((again.version, again.model.sha256), (3, old.model.sha256.clone()));
        shop.until_under_key(1, 3).await;
        shop.until_under_key(2, 0).await;
        let back_again = shop.gateway(1);
        until("it has the old one again", || back_again.0.version() == 3).await;
        until("the version is reported", || {
            let live = shop.store.live().unwrap();
            live.values().any(|live| live.version == 3 && live.model == old.model.checksum)
        })
        .await;
        until("the one that has it is suspect", || is_suspect(shop)).await;
        shop.store.request_rollout_change(second, &UserRequest::Abort, "anna").unwrap();
        until("it is over", || rollout(second).phase.is_over()).await;
        // A restarted centre still raises the alarm.
        centre.end().await;
        let centre = shop.centre(&shop.url()).await;
        tokio::time::sleep(Duration::from_secs(3)).await;
        assert!(is_suspect(shop), "aborted, but not suspect");
        *residual.lock().unwrap() = 4.0;
        let quick = soak(0.0);
        let (third, given) = start_way_back(&shop.store, &all[0].0, quick, "bert").unwrap();
        assert_eq!(given.sha256, old.model.sha256);
        until("it has the one before", || staying.version() == 3).await;
        until("nothing is suspect", || !is_suspect(shop)).await;
        until("it is done", || rollout(third.id).phase == Phase::Done).await;
        shop.until_under_key(2, 0).await;
        centre.end().await;
        stays.abort();
        back_again.1.abort();
    });
}

#[test]
fn the_user_may_keep_a_suspect_model() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateway = shop.gateway(0);
        let id = shop.roll_out(7, soak(600.0));
        let name = shop.name(0).clone();
        until("it has it", || gateway.0.version() == 1).await;
        until("its answer is stored", || shop.store.versions(&name).unwrap()[0].outcome.is_some())
            .await;
        let early = shop.store.keep_model(id, &name, "bert").unwrap_err();
        assert!(early.to_string().contains("is running or done"), "{early}");
        shop.store.request_rollout_change(id, &UserRequest::Abort, "anna").unwrap();
        until("it is suspect", || is_suspect(shop)).await;
        let alarms = shop.store.open_alarms().unwrap();
        let text = alarms.iter().find(|alarm| alarm.kind == AlarmKind::Suspect);
        let text = &text.unwrap().text;
        assert!(text.contains("was ended by anna before it was done"), "{text}");
        // Without a previous model the text proposes no return to one.
        assert!(!text.contains("model back"), "{text}");
        assert!(text.contains("`rollout keep 1 mill-0`"), "{text}");
        assert!(start_way_back(&shop.store, &name, Rules::default(), "bert").is_err());
        // Changed settings do not clear the alarm.
        let mut machine = shop.machines[0].0.clone();
        machine.condition_s = Some(2);
        shop.store.put_machine(&machine, "anna").unwrap();
        until("the settings are accepted", || gateway.0.version() == 2).await;
        tokio::time::sleep(Duration::from_secs(2)).await;
        assert!(is_suspect(shop));
        shop.store.keep_model(id, &name, "bert").unwrap();
        until("the alarm is closed", || !is_suspect(shop)).await;
        let audit = shop.store.audit_records(None, 50).unwrap();
        let kept = audit.iter().find(|record| record.action == "rollout.keep");
        assert_eq!(kept.map(|record| record.by.as_str()), Some("bert"));
        centre.end().await;
        gateway.1.abort();
    });
}

/// A machine activated a model, but the acknowledgement arrives after the roll-out has stopped, so its key is empty
/// while it corrects. The machine is suspect, changed settings reach it, and the user may keep the model.
#[test]
fn a_machine_with_a_withdrawn_version_is_suspect_and_can_be_disabled() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let rules = Rules { answer_s: 1.0, ..Rules::default() };
        let id = shop.roll_out(7, rules);
        let name = shop.name(0).clone();
        shop.until_stopped(id, "").await;
        shop.until_under_key(0, 0).await;
        let without = shop.store.keep_model(id, &name, "bert").unwrap_err();
        assert!(without.to_string().contains("is not active on mill-0"), "{without}");
        let reported = GatewayState::default();
        reported.version.store(1, Ordering::Relaxed);
        let gateway = tokio::spawn(gateway::run(shop.plan(0, "run-0"), reported.clone()));
        until("it is suspect", || is_suspect(shop)).await;
        assert!(shop.store.issued(&name).unwrap().is_none());
        let mut machine = shop.machines[0].0.clone();
        machine.enable = false;
        shop.store.put_machine(&machine, "anna").unwrap();
        until("the settings are accepted", || reported.version() == 2).await;
        let manifest = manifest(shop.issued(0).unwrap().value.as_bytes());
        assert!(!manifest.enable);
        assert_eq!(manifest.model.sha256, model(7).model.sha256);
        until("the version is reported", || {
            shop.store.live().unwrap().values().any(|live| live.version == 2)
        })
        .await;
        tokio::time::sleep(Duration::from_secs(2)).await;
        assert!(is_suspect(shop), "changed settings do not clear the alarm");
        shop.store.keep_model(id, &name, "bert").unwrap();
        until("the alarm is closed", || !is_suspect(shop)).await;
        centre.end().await;
        gateway.abort();
    });
}
