//! The whole: a centre, a real `nats-server`, gateways; and what happens when parts of it fail.

use std::{
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use volcomp_centre::{
    records::AlarmKind,
    rollout::{Phase, Rules, Wish},
};
use volcomp_fleet::Kind;

use crate::{
    gateway::{self, Told},
    shop::{LONG, Shop, Wire, soak, stored, until},
    support::{condition, envelope, received, tell},
};

fn quick() -> Rules {
    Rules {
        waves: vec![50, 100],
        soak_s: 2.0,
        answer_s: 60.0,
        ..Rules::default()
    }
}

/// Every condition that the server has acknowledged to a gateway is stored, once.
async fn all_is_stored(shop: &Shop, gateways: Vec<(Told, tokio::task::JoinHandle<()>)>) {
    for (place, (told, task)) in gateways.into_iter().enumerate() {
        // One that is under way may be stored although nobody was told.
        task.abort();
        let _ = task.await;
        let told = told.conditions();
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
    Shop::run(1, 4, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..4).map(|place| shop.gateway(place)).collect();
        let id = shop.roll_out(7, quick());
        shop.until_done(id).await;
        for (told, _) in &gateways {
            assert_eq!(told.version(), 1);
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
        all_is_stored(shop, gateways).await;
        until("silence is told", || shop.is_open(AlarmKind::Silent)).await;
        centre.end().await;
    });
}

/// The centre is ended in the middle of a roll-out and started again: it goes on from the store.
#[test]
fn a_centre_that_is_started_again_goes_on() {
    Shop::run(1, 4, async |shop| {
        let gateways: Vec<_> = (0..4).map(|place| shop.gateway(place)).collect();
        let centre = shop.centre(&shop.url()).await;
        let id = shop.roll_out(7, quick());
        let state = || shop.rollout(id);
        until("the first has it", || gateways[0].0.version() == 1).await;
        centre.end().await;
        assert_eq!(state().phase, Phase::Running);
        let told = |place: usize| gateways[place].0.version();
        assert_eq!(told(3), 0, "not all of them");
        // What the machines say while there is no centre waits at the server.
        let before = gateways[1].0.conditions();
        until("they go on telling", || {
            gateways[1].0.conditions() > before + 10
        })
        .await;
        let centre = shop.centre(&shop.url()).await;
        until("the roll-out is done", || state().phase == Phase::Done).await;
        assert_eq!((0..4).map(told).collect::<Vec<_>>(), [1; 4], "each once");
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

#[test]
fn a_rise_of_the_residual_stops_the_roll_out_by_itself() {
    Shop::run(1, 3, async |shop| {
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
        let id = shop.roll_out(7, soak(600.0));
        until("the first has it", || gateways[0].0.version() == 1).await;
        *residuals[0].lock().unwrap() = 40.0;
        shop.until_stopped(id, "residual").await;
        until("a person is told", || shop.is_open(AlarmKind::Rollout)).await;
        assert_eq!(gateways[1].0.version(), 0);
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

/// A thief of the credentials of one machine has an answer of the server stored under another's key: the machine refuses it,
/// and the centre puts its own value back.
#[test]
fn a_foreign_value_is_replaced() {
    Shop::run(1, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        let id = shop.roll_out(7, quick());
        shop.until_done(id).await;
        shop.forge().await;
        until("it is seen", || shop.is_open(AlarmKind::Clobbered)).await;
        let own = shop.issued(1).unwrap().value;
        let hub = shop.hub().await;
        let end = std::time::Instant::now() + LONG;
        while !(hub.desired(shop.name(1)).await)
            .is_ok_and(|value| value.is_some_and(|it| it == own))
        {
            assert!(std::time::Instant::now() < end, "it is not put back");
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        assert_eq!(gateways[1].0.version(), 1);
        centre.end().await;
    });
}

/// The same identity twice: both are heard, and a person is told.
#[test]
fn a_clone_is_seen() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let one = shop.gateway(0);
        let told = Told::default();
        let plan = shop.plan(0, "the copy");
        let copy = tokio::spawn(gateway::run(plan, told.clone()));
        until("it is told", || shop.is_open(AlarmKind::Clone)).await;
        copy.abort();
        one.1.abort();
        centre.end().await;
    });
}

/// The centre is cut off from the server for longer than every time-out, while machines go on telling; then the wire heals.
#[test]
fn nothing_is_lost_when_the_centre_was_cut_off() {
    Shop::run(1, 3, async |shop| {
        let wire = Wire::to(&shop.settings[0].listen).await;
        let centre = shop.centre(&wire.url).await;
        let gateways: Vec<_> = (0..3).map(|place| shop.gateway(place)).collect();
        let id = shop.roll_out(7, quick());
        until("the first has it", || gateways[0].0.version() == 1).await;
        wire.cut(true);
        // Longer than the server waits for an acknowledgement, and than either side waits for a sign of life.
        tokio::time::sleep(Duration::from_secs(40)).await;
        wire.cut(false);
        let gone = || shop.rollout(id);
        until("the roll-out goes on", || gone().phase == Phase::Done).await;
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

/// A node of the cluster is killed, and one more connection with it: what was acknowledged to a gateway is stored.
#[test]
fn a_node_of_the_cluster_is_killed() {
    Shop::run(3, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        let told = |place: usize| gateways[place].0.conditions();
        until("they tell", || told(0) > 5 && told(1) > 5).await;
        let id = shop.roll_out(7, quick());
        until("the first has it", || gateways[0].0.version() == 1).await;
        shop.servers[0] = None;
        let before = (told(0), told(1));
        until("they go on telling", || {
            told(0) > before.0 + 5 && told(1) > before.1 + 5
        })
        .await;
        shop.until_done(id).await;
        shop.start_server(0);
        let before = told(0);
        until("with all nodes again", || told(0) > before + 5).await;
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

/// The disk of the centre is full: nothing is acknowledged; there is room again: everything is stored.
#[test]
fn a_full_disk_loses_nothing() {
    Shop::run(1, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        until("both are heard", || shop.store.live().unwrap().len() == 2).await;
        shop.store.limit_pages(1).unwrap();
        let before = gateways[0].0.conditions();
        until("they go on telling", || {
            gateways[0].0.conditions() > before + 30
        })
        .await;
        shop.store.limit_pages(u32::MAX - 1).unwrap();
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

/// One machine (or a thief of its nkey) tells that a huge version is in force: it gets versions all the same, and so does every other.
#[test]
fn a_huge_version_of_one_machine_stops_nobody_else() {
    for told in [u64::MAX >> 1, u64::MAX] {
        Shop::run(1, 2, async |shop| {
            let mut one = envelope("thief", 1, condition(4.0));
            one.version = told;
            let message = received("mill-0", Kind::Condition, 1, 1_800_000_000.0, &one);
            tell(&shop.store, &[message]);
            let centre = shop.centre(&shop.url()).await;
            let version = |place| shop.issued(place).map(|issued| issued.version);
            for (number, version_of_it) in [(7, 1), (8, 2)] {
                let id = shop.roll_out_to(number, &[0], quick());
                until("it is issued", || version(0) == Some(version_of_it)).await;
                shop.store.wish(id, &Wish::Abort, "anna").unwrap();
                until("it is over", || shop.rollout(id).phase.is_over()).await;
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
    Shop::run(1, 2, async |shop| {
        shop.roll_out_to(7, &[0], quick());
        shop.raw()
            .execute(
                "INSERT INTO versions VALUES ('mill-0', ?1, 'ab', NULL, 'cd', '{}')",
                [i64::MAX],
            )
            .unwrap();
        shop.roll_out_to(8, &[1], quick());
        let centre = shop.centre(&shop.url()).await;
        until("the other goes on", || shop.issued(1).is_some()).await;
        until("it is told", || {
            let open = shop.store.open_alarms().unwrap();
            let mut told = open.iter().filter(|one| one.kind == AlarmKind::Rollout);
            told.any(|one| one.text.contains("Roll-out 1 cannot go on"))
        })
        .await;
        centre.end().await;
    });
}
