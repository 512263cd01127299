//! A roll-out that is broken off: what becomes of machines that were away, and of those that have its model.

use std::sync::{Arc, atomic::Ordering};

use volcomp_centre::{
    records::AlarmKind,
    rollout::{Phase, Rules, Wish},
    versions::start_way_back,
};
use volcomp_fleet::MachineId;

use crate::{
    gateway::{self, Told},
    shop::{Shop, manifest, soak, until},
    support::model,
};

fn is_suspect(shop: &Shop) -> bool {
    let open = shop.store.open_alarms().unwrap();
    open.iter().any(|alarm| {
        let of = alarm.machine.as_ref().map(MachineId::as_str);
        alarm.kind == AlarmKind::Suspect && of == Some("mill-0")
    })
}

/// Two machines are away when a roll-out stops. The one that had a model gets it again, under a higher version, when it is back,
/// and never the one that has stopped; under the key of the one that had none stands nothing. The machine that has the model is
/// told as suspect until it has the one before again.
#[test]
fn a_machine_that_was_away_does_not_take_what_has_stopped() {
    Shop::run(1, 3, async |shop| {
        let (old, new) = (model(7), model(8));
        let centre = shop.centre(&shop.url()).await;
        let plan = shop.plan(0, "run-0");
        let residual = Arc::clone(&plan.residual_um);
        let staying = Told::default();
        let stays = tokio::spawn(gateway::run(plan, staying.clone()));
        let leaves = shop.gateway(1);
        let quick = Rules {
            soak_s: 0.0,
            waves: vec![100],
            ..Rules::default()
        };
        let first = shop.roll_out_to(7, &[0, 1], quick);
        let rollout = |id| shop.rollout(id);
        shop.until_done(first).await;
        leaves.1.abort();
        shop.store.add_model(&new.model, &new.text).unwrap();
        let all: Vec<_> = (shop.machines.iter())
            .map(|(machine, _)| (machine.identity.machine.clone(), true))
            .collect();
        let rules = Rules {
            soak_s: 600.0,
            answer_s: 600.0,
            ..Rules::default()
        };
        let begun = shop
            .store
            .begin_rollout(&new.model.sha256, &all, rules, "anna");
        let second = begun.unwrap().id;
        let issued = |place: usize| shop.store.issued(&all[place].0).unwrap();
        until("it is sent", || {
            issued(2).is_some() && issued(1).unwrap().version == 2
        })
        .await;
        until("one has it", || staying.version() == 2).await;
        assert!(!is_suspect(shop));
        *residual.lock().unwrap() = 400.0;
        shop.until_stopped(second, "").await;
        until("it is taken back", || {
            issued(2).is_none() && issued(1).unwrap().version == 3
        })
        .await;
        let again = manifest(issued(1).unwrap().value.as_bytes());
        assert_eq!(
            (again.version, again.model.sha256),
            (3, old.model.sha256.clone())
        );
        shop.until_under_key(1, 3).await;
        shop.until_under_key(2, 0).await;
        // Back again, it takes what stands under its key now.
        let back_again = shop.gateway(1);
        until("it has the old one again", || back_again.0.version() == 3).await;
        until("it tells so", || {
            let live = shop.store.live().unwrap();
            live.values()
                .any(|live| live.version == 3 && live.model == old.model.checksum)
        })
        .await;
        until("the one that has it is suspect", || is_suspect(shop)).await;
        shop.store.wish(second, &Wish::Abort, "anna").unwrap();
        until("it is over", || rollout(second).phase.is_over()).await;
        // A centre that is started again knows it, too.
        centre.end().await;
        let centre = shop.centre(&shop.url()).await;
        tokio::time::sleep(std::time::Duration::from_secs(3)).await;
        assert!(is_suspect(shop), "ended for good, and nobody is told");
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

/// Somebody decides that a machine keeps the model: that is written down, and nobody is told any more.
#[test]
fn a_machine_may_keep_the_model() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateway = shop.gateway(0);
        let id = shop.roll_out(7, soak(600.0));
        let name = shop.name(0).clone();
        until("it has it", || gateway.0.version() == 1).await;
        until("its answer is stored", || {
            shop.store.versions(&name).unwrap()[0].outcome.is_some()
        })
        .await;
        let early = shop.store.keep_model(id, &name, "bert").unwrap_err();
        assert!(early.to_string().contains("goes on or is done"), "{early}");
        shop.store.wish(id, &Wish::Abort, "anna").unwrap();
        until("it is suspect", || is_suspect(shop)).await;
        let alarms = shop.store.open_alarms().unwrap();
        let text = alarms.iter().find(|alarm| alarm.kind == AlarmKind::Suspect);
        let text = &text.unwrap().text;
        assert!(
            text.contains("was ended by anna before it was done"),
            "{text}"
        );
        // It has had no other model: what cannot be done is not proposed.
        assert!(!text.contains("model back"), "{text}");
        assert!(text.contains("`rollout keep 1 mill-0`"), "{text}");
        assert!(start_way_back(&shop.store, &name, Rules::default(), "bert").is_err());
        // Other settings make nothing good.
        let mut machine = shop.machines[0].0.clone();
        machine.condition_s = Some(2);
        shop.store.put_machine(&machine, "anna").unwrap();
        until("it is told", || gateway.0.version() == 2).await;
        tokio::time::sleep(std::time::Duration::from_secs(2)).await;
        assert!(is_suspect(shop));
        shop.store.keep_model(id, &name, "bert").unwrap();
        until("nobody is told any more", || !is_suspect(shop)).await;
        let audit = shop.store.audit_records(None, 50).unwrap();
        let kept = audit.iter().find(|record| record.action == "rollout.keep");
        assert_eq!(kept.map(|record| record.by.as_str()), Some("bert"));
        centre.end().await;
        gateway.1.abort();
    });
}

/// A machine took a model, and its answer was lost until the roll-out had stopped and was taken back: nothing is under its key, and it
/// corrects. That is told, other settings reach it, and it may keep what it has.
#[test]
fn a_machine_that_has_what_was_taken_back_is_suspect_and_can_be_disabled() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let rules = Rules {
            answer_s: 1.0,
            ..Rules::default()
        };
        let id = shop.roll_out(7, rules);
        let name = shop.name(0).clone();
        shop.until_stopped(id, "").await;
        shop.until_under_key(0, 0).await;
        let without = shop.store.keep_model(id, &name, "bert").unwrap_err();
        assert!(without.to_string().contains("does not have"), "{without}");
        let told = Told::default();
        told.version.store(1, Ordering::Relaxed);
        let gateway = tokio::spawn(gateway::run(shop.plan(0, "run-0"), told.clone()));
        until("it is suspect", || is_suspect(shop)).await;
        assert!(shop.store.issued(&name).unwrap().is_none());
        let mut machine = shop.machines[0].0.clone();
        machine.enable = false;
        shop.store.put_machine(&machine, "anna").unwrap();
        until("it is told", || told.version() == 2).await;
        let manifest = manifest(shop.issued(0).unwrap().value.as_bytes());
        assert!(!manifest.enable);
        assert_eq!(manifest.model.sha256, model(7).model.sha256);
        until("it tells so", || {
            shop.store
                .live()
                .unwrap()
                .values()
                .any(|live| live.version == 2)
        })
        .await;
        tokio::time::sleep(std::time::Duration::from_secs(2)).await;
        assert!(is_suspect(shop), "settings make nothing good");
        shop.store.keep_model(id, &name, "bert").unwrap();
        until("nobody is told any more", || !is_suspect(shop)).await;
        centre.end().await;
        gateway.abort();
    });
}
