//! What the engine makes of what machines tell: the residual before, and the day on which a calibration is due.

use std::time::Duration;

use volcomp_centre::{records::AlarmKind, rollout::Phase};

use crate::{
    gateway::{self, Told},
    shop::{Shop, soak, until},
    support::model,
};

/// Where a machine tells its condition every five seconds, four looks of five see no residual: the last one counts as that from before.
#[test]
fn a_rise_of_the_residual_is_seen_where_conditions_are_rare() {
    Shop::run(1, 1, async |shop| {
        let centre = shop.centre(&shop.url()).await;
        let mut plan = shop.plan(0, "run-0");
        plan.condition_every = Duration::from_secs(5);
        let residual = plan.residual_um.clone();
        let told = Told::default();
        let task = tokio::spawn(gateway::run(plan, told.clone()));
        until("three are told", || told.conditions() == 3).await;
        // It has told 4 µm three times. The roll-out starts between two conditions.
        tokio::time::sleep(Duration::from_millis(2200)).await;
        let rules = soak(40.0);
        let id = shop.roll_out(7, rules);
        until("it has it", || told.version() == 1).await;
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

/// What renews a date is tested at the interface, which goes by the same rule.
#[test]
fn a_calibration_that_is_due_raises_an_alarm() {
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
