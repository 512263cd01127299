//! What the engine makes of what machines tell: the residual before, and the day on which a calibration is due.

use std::{sync::atomic::Ordering, time::Duration};

use volcomp_centre::{
    records::AlarmKind,
    rollout::{Phase, Rules},
};
use volcomp_fleet::{Acknowledgement, Kind, LinkSettings, MachineLink, ModelRef, Outcome};

use crate::{
    gateway::{self, Told},
    shop::{Shop, runtime, until},
    support::{envelope, model},
};

/// Where a machine tells its condition every five seconds, four looks of five see no residual: the last one counts as that from before.
#[test]
fn a_rise_of_the_residual_is_seen_where_conditions_are_rare() {
    let Some(shop) = Shop::new(1, 1) else { return };
    runtime().block_on(async {
        let centre = shop.centre(&shop.url()).await;
        let mut plan = shop.plan(0, "run-0");
        plan.condition_every = Duration::from_secs(5);
        let residual = plan.residual_um.clone();
        let told = Told::default();
        let task = tokio::spawn(gateway::run(plan, told.clone()));
        until("three are told", || {
            told.conditions.load(Ordering::Relaxed) == 3
        })
        .await;
        // It has told 4 µm three times. The roll-out starts between two conditions.
        tokio::time::sleep(Duration::from_millis(2200)).await;
        let rules = Rules {
            soak_s: 40.0,
            ..Rules::default()
        };
        let id = shop.roll_out(7, rules);
        until("it has it", || told.version.load(Ordering::Relaxed) == 1).await;
        *residual.lock().unwrap() = 40.0;
        let rollout = || shop.store.rollout(id).unwrap().unwrap();
        until("it is over", || !matches!(rollout().phase, Phase::Running)).await;
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

/// A calibration that was refused renews nothing: the machine corrects by the old one, whose date has passed.
#[test]
fn a_refused_model_does_not_end_a_due_date() {
    let Some(shop) = Shop::new(1, 1) else { return };
    runtime().block_on(async {
        let mut machine = shop.machines[0].0.clone();
        machine.due_days = Some(30);
        shop.store.put_machine(&machine, "anna").unwrap();
        let name = machine.identity.machine.clone();
        let is_due = || {
            let open = shop.store.open_alarms().unwrap();
            open.iter().any(|alarm| alarm.kind == AlarmKind::Due)
        };
        let mut old = model(7);
        old.model.measured = "2020-01-01".into();
        shop.store.add_model(&old.model, &old.text).unwrap();
        let new = model(8);
        shop.store.add_model(&new.model, &new.text).unwrap();
        let begin = |sha256: &str| {
            let machines = [(name.clone(), false)];
            let rules = Rules { soak_s: 0.0, ..Rules::default() };
            shop.store.begin_rollout(sha256, &machines, rules, "anna").unwrap().id
        };
        let centre = shop.centre(&shop.url()).await;
        let first = begin(&old.model.sha256);
        until("it is due", is_due).await;
        let gateway = shop.gateway(0);
        until("it is over", || shop.store.rollout(first).unwrap().unwrap().phase.is_over()).await;
        gateway.1.abort();
        begin(&new.model.sha256);
        until("the new one is sent", || shop.store.issued(&name).unwrap().unwrap().version == 2).await;
        let issued = shop.store.issued(&name).unwrap().unwrap();
        let answer = Acknowledgement {
            version: 2,
            value_sha256: ModelRef::of(issued.value.as_bytes()).sha256,
            outcome: Outcome::Refused { why: "no".into() },
        };
        let (identity, key) = (&shop.machines[0].0.identity, &shop.machines[0].1);
        let settings = LinkSettings { url: shop.url(), seed: key.seed().unwrap(), roots: None };
        let link = MachineLink::connect(&settings, identity).await.unwrap();
        let bytes = serde_json::to_vec(&envelope("b", 1, answer)).unwrap();
        while link.publish(Kind::Ack, "b-1", bytes.clone().into()).await.is_err() {
            tokio::time::sleep(Duration::from_millis(200)).await;
        }
        until("the refusal is told", || {
            let open = shop.store.open_alarms().unwrap();
            open.iter().any(|alarm| alarm.kind == AlarmKind::Refused)
        })
        .await;
        tokio::time::sleep(Duration::from_secs(2)).await;
        let due = is_due();
        centre.end().await;
        assert!(due, "it refused the new calibration and corrects by one of 2020, and nobody is told that it is due");
    });
}
