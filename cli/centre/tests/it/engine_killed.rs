//! What a centre that was killed knows when it is started again.

use std::sync::atomic::Ordering;

use volcomp_centre::{
    records::AlarmKind,
    rollout::{Phase, Rules, Step},
};
use volcomp_fleet::{Acknowledgement, Kind, ModelRef, Outcome};

use crate::{
    shop::{Shop, soak, until},
    support::{envelope, received, tell},
};

/// A machine refuses the model. Its answer is stored and acknowledged, and the centre is killed before its next look (up to a second): the
/// roll-out hears of it when the centre is started again.
#[test]
fn a_refusal_that_was_acknowledged_outlives_the_centre() {
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
        // What its writer does, then it is killed.
        let issued = shop.issued(1).unwrap();
        let answer = Acknowledgement {
            version: issued.version,
            value_sha256: ModelRef::of(issued.value.as_bytes()).sha256,
            outcome: Outcome::Refused {
                why: "it has other axes".into(),
            },
        };
        let message = received(
            "mill-1",
            Kind::Ack,
            1,
            1_800_000_000.0,
            &envelope("b", 1, answer),
        );
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
            "mill-1 has refused it, and it was sent on to mill-2: {:#?}",
            shop.rollout(id)
        );
    });
}

/// A foreign value is put under a key while the centre is down.
#[test]
fn a_foreign_value_from_while_the_centre_was_down_is_told() {
    Shop::run(1, 2, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let gateways: Vec<_> = (0..2).map(|place| shop.gateway(place)).collect();
        let rules = soak(0.0);
        let id = shop.roll_out(7, rules);
        shop.until_done(id).await;
        centre.end().await;
        shop.forge().await;
        until("it has reached the machine", || {
            gateways[1].0.refused.load(Ordering::Relaxed) > 0
        })
        .await;
        let centre = shop.centre(&shop.url()).await;
        until("a person is told", || shop.is_open(AlarmKind::Clobbered)).await;
        centre.end().await;
    });
}
