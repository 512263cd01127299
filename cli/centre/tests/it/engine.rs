//! The whole: a centre, a real `nats-server`, gateways; and what happens when parts of it fail.

use std::{
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use volcomp_centre::{
    ingest::Ingest,
    records::AlarmKind,
    rollout::{Phase, Rules, Wish},
};
use volcomp_fleet::Kind;

use crate::{
    gateway::{self, Told},
    shop::{LONG, Shop, Wire, runtime, stored, until},
    support::{condition, envelope, received},
};

fn quick() -> Rules {
    Rules {
        waves: vec![50, 100],
        soak_s: 2.0,
        answer_s: 60.0,
        ..Rules::default()
    }
}

fn is_open(shop: &Shop, kind: AlarmKind) -> bool {
    let open = shop.store.open_alarms().unwrap();
    open.iter().any(|alarm| alarm.kind == kind)
}

/// Every condition that the server has acknowledged to a gateway is stored, once.
async fn all_is_stored(shop: &Shop, gateways: Vec<(Told, tokio::task::JoinHandle<()>)>) {
    for (place, (told, task)) in gateways.into_iter().enumerate() {
        // One that is under way may be stored although nobody was told.
        task.abort();
        let _ = task.await;
        let told = told.conditions.load(Ordering::Relaxed);
        let machine = format!("mill-{place}");
        until("everything is stored", || {
            stored(shop.folder.path(), &machine) >= told
        })
        .await;
        let stored = stored(shop.folder.path(), &machine);
        assert!(stored <= told + 1, "{machine}: {stored} stored of {told}");
    }
}

#[test]
fn a_model_is_rolled_out_and_what_machines_say_is_stored() {
    let Some(shop) = Shop::new(1, 4) else { return };
    runtime().block_on(async {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..4).map(|place| shop.gateway(place)).collect();
        let id = shop.roll_out(7, quick());
        until("the roll-out is done", || {
            shop.store.rollout(id).unwrap().unwrap().phase == Phase::Done
        })
        .await;
        for (told, _) in &gateways {
            assert_eq!(told.version.load(Ordering::Relaxed), 1);
            assert_eq!(told.refused.load(Ordering::Relaxed), 0);
        }
        until("each answer stands at its version", || {
            let versions = shop.store.newest_versions().unwrap();
            versions
                .values()
                .filter(|one| one.outcome.is_some())
                .count()
                == 4
        })
        .await;
        until("each whole state is there", || {
            let mut machines = shop.machines.iter();
            machines.all(|(machine, _)| {
                let telemetry = shop.store.telemetry(&machine.identity.machine);
                telemetry
                    .unwrap()
                    .is_some_and(|(_, body)| body["whole"] == true)
            })
        })
        .await;
        all_is_stored(&shop, gateways).await;
        until("silence is told", || is_open(&shop, AlarmKind::Silent)).await;
        centre.end().await;
    });
}

/// The centre is ended in the middle of a roll-out and started again: it goes on from the store.
#[test]
fn a_centre_that_is_started_again_goes_on() {
    let Some(shop) = Shop::new(1, 4) else { return };
    runtime().block_on(async {
        let gateways: Vec<_> = (0..4).map(|place| shop.gateway(place)).collect();
        let centre = shop.centre(&shop.url()).await;
        let id = shop.roll_out(7, quick());
        let state = || shop.store.rollout(id).unwrap().unwrap();
        until("the first has it", || {
            gateways[0].0.version.load(Ordering::Relaxed) == 1
        })
        .await;
        centre.end().await;
        assert_eq!(state().phase, Phase::Running);
        let told = |place: usize| gateways[place].0.version.load(Ordering::Relaxed);
        assert_eq!(told(3), 0, "not all of them");
        // What the machines say while there is no centre waits at the server.
        let before = gateways[1].0.conditions.load(Ordering::Relaxed);
        until("they go on telling", || {
            gateways[1].0.conditions.load(Ordering::Relaxed) > before + 10
        })
        .await;
        let centre = shop.centre(&shop.url()).await;
        until("the roll-out is done", || state().phase == Phase::Done).await;
        assert_eq!((0..4).map(told).collect::<Vec<_>>(), [1; 4], "each once");
        all_is_stored(&shop, gateways).await;
        centre.end().await;
    });
}

#[test]
fn a_rise_of_the_residual_stops_the_roll_out_by_itself() {
    let Some(shop) = Shop::new(1, 3) else { return };
    runtime().block_on(async {
        let centre = shop.centre(&shop.url()).await;
        let mut gateways = Vec::new();
        let mut residuals = Vec::new();
        for place in 0..3 {
            let plan = shop.plan(place, &format!("run-{place}"));
            residuals.push(Arc::clone(&plan.residual_um));
            let told = Told::default();
            gateways.push((told.clone(), tokio::spawn(gateway::run(plan, told))));
        }
        until("all are heard", || shop.store.live().unwrap().len() == 3).await;
        let rules = Rules {
            soak_s: 600.0,
            ..quick()
        };
        let id = shop.roll_out(7, rules);
        until("the first has it", || {
            gateways[0].0.version.load(Ordering::Relaxed) == 1
        })
        .await;
        *residuals[0].lock().unwrap() = 40.0;
        until("it stops", || {
            let phase = shop.store.rollout(id).unwrap().unwrap().phase;
            matches!(phase, Phase::Stopped { why } if why.contains("residual"))
        })
        .await;
        until("a person is told", || is_open(&shop, AlarmKind::Rollout)).await;
        assert_eq!(gateways[1].0.version.load(Ordering::Relaxed), 0);
        all_is_stored(&shop, gateways).await;
        centre.end().await;
    });
}

/// A thief of the credentials of one machine has an answer of the server stored under another's key: the machine refuses it,
/// and the centre puts its own value back.
#[test]
fn a_foreign_value_is_replaced() {
    let Some(shop) = Shop::new(1, 2) else { return };
    runtime().block_on(async {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        let id = shop.roll_out(7, quick());
        until("the roll-out is done", || {
            shop.store.rollout(id).unwrap().unwrap().phase == Phase::Done
        })
        .await;
        let (thief, key) = &shop.machines[0];
        let client = async_nats::ConnectOptions::with_nkey(key.seed().unwrap())
            .custom_inbox_prefix("_INBOX_mill-0")
            .connect(shop.url())
            .await
            .unwrap();
        let subject = volcomp_fleet::Subjects::of(&thief.identity).condition;
        client
            .publish_with_reply(subject, "$KV.desired.mill-1", "forged".into())
            .await
            .unwrap();
        client.flush().await.unwrap();
        until("it is seen", || is_open(&shop, AlarmKind::Clobbered)).await;
        let own = shop.store.issued(&shop.machines[1].0.identity.machine);
        let own = own.unwrap().unwrap().value;
        let hub = volcomp_fleet::Hub::connect(&volcomp_fleet::LinkSettings {
            url: shop.url(),
            seed: shop.centre.seed().unwrap(),
            roots: None,
        })
        .await
        .unwrap();
        let end = std::time::Instant::now() + LONG;
        loop {
            let found = hub.desired(&shop.machines[1].0.identity.machine).await;
            if found.is_ok_and(|value| value.is_some_and(|value| value == own)) {
                break;
            }
            assert!(std::time::Instant::now() < end, "it is not put back");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        assert_eq!(gateways[1].0.version.load(Ordering::Relaxed), 1);
        centre.end().await;
    });
}

/// The same identity twice: both are heard, and a person is told.
#[test]
fn a_clone_is_seen() {
    let Some(shop) = Shop::new(1, 1) else { return };
    runtime().block_on(async {
        let centre = shop.centre(&shop.url()).await;
        let one = shop.gateway(0);
        let told = Told::default();
        let plan = shop.plan(0, "the copy");
        let copy = tokio::spawn(gateway::run(plan, told.clone()));
        until("it is told", || is_open(&shop, AlarmKind::Clone)).await;
        copy.abort();
        one.1.abort();
        centre.end().await;
    });
}

/// The centre is cut off from the server for longer than every time-out, while machines go on telling; then the wire heals.
#[test]
fn nothing_is_lost_when_the_centre_was_cut_off() {
    let Some(shop) = Shop::new(1, 3) else { return };
    runtime().block_on(async {
        let wire = Wire::to(&shop.settings[0].listen).await;
        let centre = shop.centre(&wire.url).await;
        let gateways: Vec<_> = (0..3).map(|place| shop.gateway(place)).collect();
        let id = shop.roll_out(7, quick());
        until("the first has it", || {
            gateways[0].0.version.load(Ordering::Relaxed) == 1
        })
        .await;
        wire.cut(true);
        // Longer than the server waits for an acknowledgement, and than either side waits for a sign of life.
        tokio::time::sleep(Duration::from_secs(40)).await;
        wire.cut(false);
        let gone = || shop.store.rollout(id).unwrap().unwrap();
        until("the roll-out goes on", || gone().phase == Phase::Done).await;
        all_is_stored(&shop, gateways).await;
        centre.end().await;
    });
}

/// A node of the cluster is killed, and one more connection with it: what was acknowledged to a gateway is stored.
#[test]
fn a_node_of_the_cluster_is_killed() {
    let Some(mut shop) = Shop::new(3, 2) else {
        return;
    };
    runtime().block_on(async {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        let told = |place: usize| gateways[place].0.conditions.load(Ordering::Relaxed);
        until("they tell", || told(0) > 5 && told(1) > 5).await;
        let id = shop.roll_out(7, quick());
        until("the first has it", || {
            gateways[0].0.version.load(Ordering::Relaxed) == 1
        })
        .await;
        shop.servers[0] = None;
        let before = (told(0), told(1));
        until("they go on telling", || {
            told(0) > before.0 + 5 && told(1) > before.1 + 5
        })
        .await;
        until("the roll-out is done", || {
            shop.store.rollout(id).unwrap().unwrap().phase == Phase::Done
        })
        .await;
        shop.start_server(0);
        let before = told(0);
        until("with all nodes again", || told(0) > before + 5).await;
        all_is_stored(&shop, gateways).await;
        centre.end().await;
    });
}

/// The disk of the centre is full: nothing is acknowledged; there is room again: everything is stored.
#[test]
fn a_full_disk_loses_nothing() {
    let Some(shop) = Shop::new(1, 2) else { return };
    runtime().block_on(async {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        until("both are heard", || shop.store.live().unwrap().len() == 2).await;
        shop.store.limit_pages(1).unwrap();
        let before = gateways[0].0.conditions.load(Ordering::Relaxed);
        until("they go on telling", || {
            gateways[0].0.conditions.load(Ordering::Relaxed) > before + 30
        })
        .await;
        shop.store.limit_pages(u32::MAX - 1).unwrap();
        all_is_stored(&shop, gateways).await;
        centre.end().await;
    });
}

/// One machine (or a thief of its nkey) tells that a huge version is in force: it gets versions all the same, and so does every other.
#[test]
fn a_huge_version_of_one_machine_stops_nobody_else() {
    for told in [u64::MAX >> 1, u64::MAX] {
        let Some(shop) = Shop::new(1, 2) else { return };
        runtime().block_on(async {
            let mut ingest = Ingest::of(&shop.store).unwrap();
            let mut one = envelope("thief", 1, condition(4.0));
            one.version = told;
            let message = received("mill-0", Kind::Condition, 1, 1_800_000_000.0, &one);
            ingest.take(&shop.store, &[message]).unwrap();
            ingest.store_live(&shop.store).unwrap();
            let centre = shop.centre(&shop.url()).await;
            let version = |place: usize| {
                let machine = &shop.machines[place].0.identity.machine;
                shop.store
                    .issued(machine)
                    .unwrap()
                    .map(|issued| issued.version)
            };
            for (number, version_of_it) in [(7, 1), (8, 2)] {
                let id = shop.roll_out_to(number, &[0], quick());
                until("it is issued", || version(0) == Some(version_of_it)).await;
                shop.store.wish(id, &Wish::Abort, "anna").unwrap();
                until("it is over", || {
                    shop.store.rollout(id).unwrap().unwrap().phase.is_over()
                })
                .await;
            }
            shop.roll_out_to(9, &[1], quick());
            until("the other gets its own", || version(1) == Some(1)).await;
            centre.end().await;
        });
    }
}

/// A roll-out whose stored state cannot be read, or whose versions have come to their end, is told, and holds up no other.
#[test]
fn a_roll_out_that_cannot_go_on_holds_up_no_other() {
    let Some(shop) = Shop::new(1, 2) else { return };
    runtime().block_on(async {
        shop.roll_out_to(7, &[0], quick());
        let raw = rusqlite::Connection::open(shop.folder.path().join("centre.db")).unwrap();
        raw.execute(
            "INSERT INTO versions VALUES ('mill-0', ?1, 'ab', NULL, 'cd', '{}')",
            [i64::MAX],
        )
        .unwrap();
        shop.roll_out_to(8, &[1], quick());
        let centre = shop.centre(&shop.url()).await;
        let other = &shop.machines[1].0.identity.machine;
        until("the other goes on", || {
            shop.store.issued(other).unwrap().is_some()
        })
        .await;
        until("it is told", || {
            let open = shop.store.open_alarms().unwrap();
            let mut told = open.iter().filter(|one| one.kind == AlarmKind::Rollout);
            told.any(|one| one.text.contains("Roll-out 1 cannot go on"))
        })
        .await;
        centre.end().await;
    });
}
