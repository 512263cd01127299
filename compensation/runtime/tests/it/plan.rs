//! What does not fit is named, with what was found and what was expected, in the units of the configuration.

use std::time::Duration;

use volcomp_port::{Axis, Clock, Controller, Description, Heartbeat};
use volcomp_runtime::{
    Cycle, GuardSettings, Model, PathPlan, PathSettings, PlanError, Sensors, guard::Quantity,
};
use volcomp_vocabulary::{AxisName, Displacement, Mm, Um, Urad};

use crate::rig::{PERIOD, control, guard, machine};

fn planned(
    describe: impl FnOnce(&mut Description),
    limit: impl FnOnce(&mut GuardSettings),
    set: impl FnOnce(&mut PathSettings),
) -> Result<PathPlan, PlanError> {
    let mut description = control([0.0; 5], &Clock::manual()).description().clone();
    let (mut guard, mut settings) = (guard(), PathSettings::default());
    describe(&mut description);
    limit(&mut guard);
    set(&mut settings);
    let model = Model::new(&machine(), guard.fading).expect("shipped");
    PathPlan::new(description, &model, &guard, &settings, PERIOD)
}

#[test]
fn what_does_not_fit_is_named() {
    let same = |_: &mut Description| {};
    let with = |error: Result<PathPlan, PlanError>| error.expect_err("it does not fit").to_string();
    let message = with(planned(
        |d| {
            d.axes[0] = Axis {
                name: AxisName::W,
                includes_correction: false,
                resolution: Displacement::Length(Mm(0.001)),
            }
        },
        |_| {},
        |_| {},
    ));
    assert!(
        message.contains("axis W: the machine") && message.contains("has the axes"),
        "{message}"
    );
    let message = with(planned(same, |guard| guard.rotary = None, |_| {}));
    assert!(
        message.contains("axis B is rotary") && message.contains("limit_urad"),
        "{message}"
    );
    let message = with(planned(
        same,
        |_| {},
        |path| {
            path.fixed
                .insert(AxisName::U, Displacement::Length(Mm(1.0)));
        },
    ));
    assert!(message.contains("fixed: axis U"), "{message}");
    let message = with(planned(
        |d| d.heartbeat = Heartbeat::Unwatched,
        |_| {},
        |_| {},
    ));
    assert!(message.contains("unwatched = true"), "{message}");
    let message = with(planned(
        |d| d.shortest_cycle = Duration::from_micros(7500),
        |_| {},
        |_| {},
    ));
    assert!(
        message.contains("cycle_ms: found 4 ms, expected at least 7.5 ms"),
        "{message}"
    );
}

/// Limits are told in µm and µrad, by the keys of the configuration.
#[test]
fn limits_are_told_in_the_units_of_the_user() {
    let coarse = |d: &mut Description| {
        for axis in &mut d.axes {
            axis.resolution = Displacement::from_micro(axis.kind(), 2.0);
        }
    };
    let error = planned(coarse, |guard| guard.linear.limit = Um(0.5), |_| {})
        .expect_err("less than a step");
    assert_eq!(
        error.to_string(),
        "simulated: [guard] limit_um of axis Z: found 0.5 µm, expected at least one step of the controller"
    );
    assert!(
        matches!(error, PlanError::Limits { axis: Some(AxisName::Z), source, .. } if source.what == Quantity::Limit)
    );
    let rotary = |guard: &mut GuardSettings| {
        if let Some(rotary) = &mut guard.rotary {
            rotary.slew_per_s = Urad(0.0);
        }
    };
    let error = planned(|_| {}, rotary, |_| {}).expect_err("it never moves");
    assert_eq!(
        error.to_string(),
        "simulated: [guard] slew_urad_per_s of axis B: found 0 µrad/s, expected a positive number"
    );
    let error = planned(
        |_| {},
        |guard| guard.hold = Duration::from_millis(1),
        |_| {},
    );
    let message = error.expect_err("shorter than a cycle").to_string();
    assert_eq!(
        message,
        "simulated: [guard] hold_ms: found 1 ms, expected at least one cycle"
    );
}

#[test]
fn a_cycle_needs_a_path() {
    let guard = guard();
    let model = Box::new(Model::new(&machine(), guard.fading).expect("shipped"));
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    let cycle = Cycle::new(model, Vec::new(), guard.hand_back, sensors, PERIOD);
    assert!(matches!(cycle.err(), Some(PlanError::Paths { found: 0 })));
}
