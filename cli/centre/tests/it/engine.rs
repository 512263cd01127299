//! A centre, a real `nats-server` and gateways end to end, with failures of each.

use std::{
    sync::{Arc, atomic::Ordering},
    time::Duration,
};

use volcomp_centre::{
    issue::settle,
    records::{AlarmKind, Machine},
    rollout::{Phase, Rules, Step, UserRequest},
    store::Store,
};
use volcomp_fleet::{Acknowledgement, Kind, ModelRef, Outcome};

use crate::{
    gateway::{self, GatewayState},
    shop::{LONG, Shop, Wire, soak, stored, until},
    support::{condition, envelope, model, received, tell},
};

fn quick() -> Rules {
    Rules { waves: vec![50, 100], soak_s: 2.0, answer_s: 60.0, ..Rules::default() }
}

/// Checks that every condition that the server has acknowledged is stored once.
async fn all_is_stored(shop: &Shop, gateways: Vec<(GatewayState, tokio::task::JoinHandle<()>)>) {
    for (place, (reported, task)) in gateways.into_iter().enumerate() {
        // A message in flight may be stored although its acknowledgement was not received.
        task.abort();
        let _ = task.await;
        let reported = reported.conditions();
        let machine = format!("mill-{place}");
        until("everything is stored", || stored(shop.folder.path(), &machine) >= reported).await;
        let stored = stored(shop.folder.path(), &machine);
        assert!(stored <= reported + 1, "{machine}: {stored} stored of {reported}");
    }
}

#[test]
fn a_rollout_completes_and_all_messages_are_stored() {
    Shop::run(1, 4, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..4).map(|place| shop.gateway(place)).collect();
        let id = shop.roll_out(7, quick());
        shop.until_done(id).await;
        for (reported, _) in &gateways {
            assert_eq!(reported.version(), 1);
            assert_eq!(reported.refused.load(Ordering::Relaxed), 0);
        }
        until("each outcome is stored", || {
            let versions = shop.store.newest_versions().unwrap();
            versions.values().filter(|one| one.outcome.is_some()).count() == 4
        })
        .await;
        until("each telemetry is stored", || {
            let mut machines = shop.machines.iter();
            machines.all(|(machine, _)| {
                let telemetry = shop.store.telemetry(&machine.identity.machine);
                telemetry.unwrap().is_some_and(|(_, body)| body["whole"] == true)
            })
        })
        .await;
        all_is_stored(shop, gateways).await;
        until("silence raises an alarm", || shop.is_open(AlarmKind::Silent)).await;
        centre.end().await;
    });
}

/// A centre restarted during a roll-out continues from the store: each machine gets its version once.
#[test]
fn a_restarted_centre_continues_the_rollout() {
    Shop::run(1, 4, async |shop| {
        let gateways: Vec<_> = (0..4).map(|place| shop.gateway(place)).collect();
        let centre = shop.centre(&shop.url()).await;
        let id = shop.roll_out(7, quick());
        let state = || shop.rollout(id);
        until("the first has it", || gateways[0].0.version() == 1).await;
        centre.end().await;
        assert_eq!(state().phase, Phase::Running);
        let reported = |place: usize| gateways[place].0.version();
        assert_eq!(reported(3), 0, "not all of them");
        // Messages sent while the centre is down wait at the server.
        let before = gateways[1].0.conditions();
        until("they keep sending", || gateways[1].0.conditions() > before + 10).await;
        let centre = shop.centre(&shop.url()).await;
        until("the roll-out is done", || state().phase == Phase::Done).await;
        assert_eq!((0..4).map(reported).collect::<Vec<_>>(), [1; 4], "each once");
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

#[test]
fn a_risen_residual_stops_the_rollout() {
    Shop::run(1, 3, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let mut gateways = Vec::new();
        let mut residuals = Vec::new();
        for place in 0..3 {
            let plan = shop.plan(place, &format!("run-{place}"));
            residuals.push(Arc::clone(&plan.residual_um));
            let reported = GatewayState::default();
            gateways.push((reported.clone(), tokio::spawn(gateway::run(plan, reported))));
        }
        until("all have sent a condition", || shop.store.live().unwrap().len() == 3).await;
        let id = shop.roll_out(7, soak(600.0));
        until("the first has it", || gateways[0].0.version() == 1).await;
        *residuals[0].lock().unwrap() = 40.0;
        shop.until_stopped(id, "residual").await;
        until("an alarm is raised", || shop.is_open(AlarmKind::Rollout)).await;
        assert_eq!(gateways[1].0.version(), 0);
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

/// A client with the stolen credentials of one machine makes the server store its acknowledgement as another machine's
/// desired value. That machine rejects it, and the centre restores its own value.
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

/// The server loses its disk while the centre runs: the centre creates the streams and the values under the keys again.
#[test]
fn a_server_without_its_disk_is_filled_again() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let (_, gateway) = shop.gateway(0);
        let id = shop.roll_out(7, quick());
        shop.until_done(id).await;
        shop.servers[0] = None;
        std::fs::remove_dir_all(&shop.settings[0].store).unwrap();
        shop.start_server(0);
        shop.until_under_key(0, 1).await;
        let count = || stored(shop.folder.path(), "mill-0");
        let before = count();
        until("its messages are collected again", || count() > before + 5).await;
        gateway.abort();
        centre.end().await;
    });
}

/// Two gateways with one identity: the messages of both are stored, and an alarm is raised.
#[test]
fn a_cloned_gateway_raises_an_alarm() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let one = shop.gateway(0);
        let reported = GatewayState::default();
        let plan = shop.plan(0, "the copy");
        let copy = tokio::spawn(gateway::run(plan, reported.clone()));
        until("an alarm is raised", || shop.is_open(AlarmKind::Clone)).await;
        copy.abort();
        one.1.abort();
        centre.end().await;
    });
}

/// The centre loses its connection to the server for longer than every timeout while the machines send. After the
/// reconnect every acknowledged message is stored once.
#[test]
fn no_message_is_lost_while_the_centre_is_disconnected() {
    Shop::run(1, 3, async |shop| {
        let wire = Wire::to(&shop.settings[0].listen).await;
        let centre = shop.centre(&wire.url).await;
        let gateways: Vec<_> = (0..3).map(|place| shop.gateway(place)).collect();
        let id = shop.roll_out(7, quick());
        until("the first has it", || gateways[0].0.version() == 1).await;
        wire.cut(true);
        // Longer than the server's acknowledgement timeout and the keep-alive intervals of both sides.
        tokio::time::sleep(Duration::from_secs(40)).await;
        wire.cut(false);
        let gone = || shop.rollout(id);
        until("the roll-out goes on", || gone().phase == Phase::Done).await;
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

#[test]
fn a_killed_cluster_server_loses_no_message() {
    Shop::run(3, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        let reported = |place: usize| gateways[place].0.conditions();
        until("both send", || reported(0) > 5 && reported(1) > 5).await;
        let id = shop.roll_out(7, quick());
        until("the first has it", || gateways[0].0.version() == 1).await;
        shop.servers[0] = None;
        let before = (reported(0), reported(1));
        until("they keep sending", || reported(0) > before.0 + 5 && reported(1) > before.1 + 5)
            .await;
        shop.until_done(id).await;
        shop.start_server(0);
        let before = reported(0);
        until("with all nodes again", || reported(0) > before + 5).await;
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

/// While the centre's disk is full, no message is acknowledged. Afterwards every message is stored.
#[test]
fn a_full_disk_loses_no_message() {
    Shop::run(1, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        until("both have sent a condition", || shop.store.live().unwrap().len() == 2).await;
        shop.store.limit_pages(1).unwrap();
        let before = gateways[0].0.conditions();
        until("they keep sending", || gateways[0].0.conditions() > before + 30).await;
        shop.store.limit_pages(u32::MAX - 1).unwrap();
        all_is_stored(shop, gateways).await;
        centre.end().await;
    });
}

/// A machine, or a thief of its nkey, reports a huge active version. Versions are still issued to this machine and all
/// others.
#[test]
fn a_huge_version_of_one_machine_does_not_block_others() {
    for reported in [u64::MAX >> 1, u64::MAX] {
        Shop::run(1, 2, async |shop| {
            let mut one = envelope("thief", 1, condition(4.0));
            one.version = reported;
            let message = received("mill-0", Kind::Condition, 1, 1_800_000_000.0, &one);
            tell(&shop.store, &[message]);
            let centre = shop.centre(&shop.url()).await;
            let version = |place| shop.issued(place).map(|issued| issued.version);
            for (number, version_of_it) in [(7, 1), (8, 2)] {
                let id = shop.roll_out_to(number, &[0], quick());
                until("it is issued", || version(0) == Some(version_of_it)).await;
                shop.store.request_rollout_change(id, &UserRequest::Abort, "anna").unwrap();
                until("it is over", || shop.rollout(id).phase.is_over()).await;
            }
            shop.roll_out_to(9, &[1], quick());
            until("the other gets its own", || version(1) == Some(1)).await;
            centre.end().await;
        });
    }
}

/// A roll-out that has no version numbers left raises an alarm; other roll-outs continue.
#[test]
fn a_broken_rollout_does_not_block_others() {
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
        until("an alarm is raised", || {
            let open = shop.store.open_alarms().unwrap();
            let mut reported = open.iter().filter(|one| one.kind == AlarmKind::Rollout);
            reported.any(|one| one.text.contains("Roll-out 1 cannot proceed"))
        })
        .await;
        centre.end().await;
    });
}

/// With one condition every five seconds, four of five passes of the centre receive no residual. The last reported
/// residual then counts as the residual before the change, so that an increase still stops the roll-out.
#[test]
fn a_risen_residual_is_detected_with_rare_conditions() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let mut plan = shop.plan(0, "run-0");
        plan.condition_every = Duration::from_secs(5);
        let residual = plan.residual_um.clone();
        let reported = GatewayState::default();
        let task = tokio::spawn(gateway::run(plan, reported.clone()));
        until("three conditions were sent", || reported.conditions() == 3).await;
        // The gateway has reported 4 µm three times. The roll-out starts between two conditions.
        tokio::time::sleep(Duration::from_millis(2200)).await;
        let rules = soak(40.0);
        let id = shop.roll_out(7, rules);
        until("it has it", || reported.version() == 1).await;
        *residual.lock().unwrap() = 40.0;
        let rollout = || shop.rollout(id);
        until("it is over", || rollout().phase != Phase::Running).await;
        task.abort();
        centre.end().await;
        assert!(
            matches!(rollout().phase, Phase::Stopped { .. }),
            "the residual has risen from 4 to 40 µm: {:?}, before {:?}",
            rollout().phase,
            rollout().targets[0].before_um
        );
    });
}

/// The HTTP tests cover which models renew the due date; the alarm follows the same rule.
#[test]
fn an_overdue_calibration_raises_an_alarm() {
    Shop::run(1, 1, async |shop| {
        let mut machine = shop.machines[0].0.clone();
        machine.due_days = Some(30);
        shop.store.put_machine(&machine, "anna").unwrap();
        let mut old = model(7);
        old.model.measured = "2020-01-01".into();
        shop.store.add_model(&old.model, &old.text).unwrap();
        let centre = shop.centre(&shop.url()).await;
        shop.roll_out(7, soak(0.0));
        until("it is due", || shop.is_open(AlarmKind::Due)).await;
        centre.end().await;
    });
}

/// A machine rejects the model, its outcome is stored and acknowledged, and the centre is killed before its next pass.
/// After the restart the roll-out stops.
#[test]
fn an_acknowledged_rejection_survives_a_kill() {
    Shop::run(1, 3, async |shop| {
        let rules = Rules {
            waves: vec![50, 100],
            soak_s: 0.0,
            answer_s: 8.0,
            tolerate: 1,
            ..Rules::default()
        };
        let centre = shop.centre(&shop.url()).await;
        let canary = shop.gateway(0);
        let id = shop.roll_out(7, rules);
        until("the second is sent", || {
            matches!(shop.rollout(id).targets[1].step, Step::Sent { .. })
        })
        .await;
        centre.end().await;
        // The writer thread stores the outcome before the kill.
        let issued = shop.issued(1).unwrap();
        let answer = Acknowledgement {
            version: issued.version,
            value_sha256: ModelRef::of(issued.value.as_bytes()).sha256,
            outcome: Outcome::Refused { why: "it has other axes".into() },
        };
        let message = received("mill-1", Kind::Ack, 1, 1_800_000_000.0, &envelope("b", 1, answer));
        tell(&shop.store, &[message]);
        let centre = shop.centre(&shop.url()).await;
        until("it stops or goes on", || {
            matches!(shop.rollout(id).phase, Phase::Stopped { .. }) || shop.issued(2).is_some()
        })
        .await;
        canary.1.abort();
        centre.end().await;
        assert!(
            matches!(shop.rollout(id).phase, Phase::Stopped { .. }),
            "mill-1 has rejected it, but it was sent to mill-2: {:#?}",
            shop.rollout(id)
        );
    });
}

#[test]
fn a_foreign_value_put_while_the_centre_was_down_raises_an_alarm() {
    Shop::run(1, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        let rules = soak(0.0);
        let id = shop.roll_out(7, rules);
        shop.until_done(id).await;
        centre.end().await;
        shop.forge().await;
        until("it has reached the machine", || gateways[1].0.refused.load(Ordering::Relaxed) > 0)
            .await;
        let centre = shop.centre(&shop.url()).await;
        until("an alarm is raised", || shop.is_open(AlarmKind::Clobbered)).await;
        centre.end().await;
    });
}

/// The database is an older copy: newer values at the server stay, also the one with whose version another one was issued meanwhile, until a higher
/// version is issued.
#[test]
fn a_restored_database_replaces_no_newer_value() {
    Shop::run(1, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        shop.until_done(shop.roll_out(7, soak(0.0))).await;
        let copy = shop.folder.path().join("copy.db");
        shop.raw().execute("VACUUM INTO ?1", [copy.to_str()]).unwrap();
        shop.until_done(shop.roll_out(8, soak(0.0))).await;
        centre.end().await;
        let hub = shop.hub().await;
        let values = async |shop: &Shop| {
            [hub.desired(shop.name(0)).await.unwrap(), hub.desired(shop.name(1)).await.unwrap()]
        };
        let newest = values(shop).await;
        shop.store = Arc::new(Store::open(&copy).unwrap());
        let enabled = shop.machines[1].0.clone();
        shop.store.put_machine(&Machine { enable: false, ..enabled.clone() }, "anna").unwrap();
        let again = settle(&shop.store, &shop.key, shop.name(1), "anna").unwrap();
        assert_eq!(again.unwrap().version, 2);
        let centre = shop.centre(&shop.url()).await;
        let why = "mill-0: found version 2 of this centre at the server, which the database does not know: the database is an older copy, and its version 1 is not sent;";
        until("an alarm is raised", || {
            let open = shop.store.open_alarms().unwrap();
            open.iter().any(|one| one.kind == AlarmKind::Server && one.text.contains(why))
        })
        .await;
        assert_eq!(values(shop).await, newest);
        shop.store.put_machine(&enabled, "anna").unwrap();
        until("the next is accepted", || gateways[1].0.version() == 3).await;
        assert_eq!(values(shop).await[0], newest[0]);
        for (_, task) in gateways {
            task.abort();
        }
        centre.end().await;
    });
}
