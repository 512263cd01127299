//! What a centre that was killed knows when it is started again.

use std::sync::atomic::Ordering;

use volcomp_centre::{
    ingest::Ingest,
    records::AlarmKind,
    rollout::{Phase, Rules, Step},
};
use volcomp_fleet::{Acknowledgement, Kind, ModelRef, Outcome, Subjects};

use crate::{
    shop::{Shop, runtime, until},
    support::{envelope, received},
};

/// A machine refuses the model. Its answer is stored and acknowledged, and the centre is killed before its next look (up to a second): the
/// roll-out hears of it when the centre is started again.
#[test]
fn a_refusal_that_was_acknowledged_outlives_the_centre() {
    let Some(shop) = Shop::new(1, 3) else { return };
    runtime().block_on(async {
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
        let rollout = || shop.store.rollout(id).unwrap().unwrap();
        until("the second is sent", || {
            matches!(rollout().targets[1].step, Step::Sent { .. })
        })
        .await;
        centre.end().await;
        // What its writer does, then it is killed.
        let machine = shop.machines[1].0.identity.machine.clone();
        let issued = shop.store.issued(&machine).unwrap().unwrap();
        let answer = Acknowledgement {
            version: issued.version,
            value_sha256: ModelRef::of(issued.value.as_bytes()).sha256,
            outcome: Outcome::Refused {
                why: "it has other axes".into(),
            },
        };
        let mut killed = Ingest::of(&shop.store).unwrap();
        let message = received(
            "mill-1",
            Kind::Ack,
            1,
            1_800_000_000.0,
            &envelope("b", 1, answer),
        );
        killed.take(&shop.store, &[message]).unwrap();
        let centre = shop.centre(&shop.url()).await;
        let third = shop.machines[2].0.identity.machine.clone();
        until("it stops or goes on", || {
            matches!(rollout().phase, Phase::Stopped { .. })
                || shop.store.issued(&third).unwrap().is_some()
        })
        .await;
        canary.1.abort();
        centre.end().await;
        assert!(
            matches!(rollout().phase, Phase::Stopped { .. }),
            "mill-1 has refused it, and it was sent on to mill-2: {:#?}",
            rollout()
        );
    });
}

/// A foreign value is put under a key while the centre is down.
#[test]
fn a_foreign_value_from_while_the_centre_was_down_is_told() {
    let Some(shop) = Shop::new(1, 2) else { return };
    runtime().block_on(async {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        let rules = Rules {
            soak_s: 0.0,
            ..Rules::default()
        };
        let id = shop.roll_out(7, rules);
        until("it is done", || {
            shop.store.rollout(id).unwrap().unwrap().phase == Phase::Done
        })
        .await;
        centre.end().await;
        let (thief, key) = &shop.machines[0];
        let client = async_nats::ConnectOptions::with_nkey(key.seed().unwrap())
            .custom_inbox_prefix("_INBOX_mill-0")
            .connect(shop.url())
            .await
            .unwrap();
        let subject = Subjects::of(&thief.identity).condition;
        client
            .publish_with_reply(subject, "$KV.desired.mill-1", "forged".into())
            .await
            .unwrap();
        client.flush().await.unwrap();
        until("it has reached the machine", || {
            gateways[1].0.refused.load(Ordering::Relaxed) > 0
        })
        .await;
        let centre = shop.centre(&shop.url()).await;
        until("a person is told", || {
            let open = shop.store.open_alarms().unwrap();
            open.iter().any(|alarm| alarm.kind == AlarmKind::Clobbered)
        })
        .await;
        centre.end().await;
    });
}
