//! Conflicts in a plan are reported with the found and the expected value in µm, µrad and ms.

use std::time::Duration;

use volcomp_model::{Fading, Machine};
use volcomp_port::{Clock, Controller, Description, Heartbeat};
use volcomp_runtime::{
    AxisSettings, ControlPath, Cycle, GuardSettings, Model, OrderRefusal, PathPlan, PathSettings,
    PlanError, Replacement, Sensors, WithoutBarrier,
    guard::{Quantity, Request, State},
};
use volcomp_vocabulary::{AxisName, Displacement, Mm, Um, Urad};

use crate::rig::{
    PERIOD, Rig, alone, control, cycle_of, guard, machine, machine_file, without_barrier,
};

fn planned(
    change: impl FnOnce(&mut Description, &mut GuardSettings, &mut PathSettings),
) -> Result<PathPlan, PlanError> {
    let mut description = control([0.0; 5], &Clock::manual()).description().clone();
    let (mut guard, mut settings) = (guard(), alone());
    change(&mut description, &mut guard, &mut settings);
    let model = Model::new(&machine(), guard.fading).expect("shipped");
    PathPlan::new(description, &model, &guard, &settings, PERIOD)
}

#[test]
fn conflicts_are_named() {
    type Change = fn(&mut Description, &mut GuardSettings, &mut PathSettings);
    let cases: [(Change, &str); 9] = [
        (|description, _, _| description.axes[0].name = AxisName::W, "axis W: the machine"),
        (
            |_, guard, _| guard.rotary = None,
            "axis B is rotary: [guard] limit_urad and slew_urad_per_s are missing",
        ),
        (
            |_, _, path| {
                let at = Displacement::Length(Mm(1.0));
                path.fixed.insert(AxisName::U, at);
            },
            "fixed: axis U",
        ),
        (|description, _, _| description.heartbeat = Heartbeat::Unwatched, "unwatched = true"),
        (
            |description, _, _| description.shortest_cycle = Duration::from_micros(7500),
            "cycle_ms: found 4 ms, expected at least 7.5 ms",
        ),
        (
            |description, guard, _| {
                for axis in &mut description.axes {
                    axis.resolution = Displacement::from_micro(axis.kind(), 2.0);
                }
                guard.linear.limit = Um(0.5);
            },
            "simulated: [guard] limit_um of axis Z: found 0.5 µm, expected at least one step of the controller, which is resolution_um (1 µm where it is not stated; on CAN the factor in the DBC file)",
        ),
        (
            |description, guard, _| {
                for axis in &mut description.axes {
                    axis.largest = Some(Displacement::from_micro(axis.kind(), 127.0));
                }
                guard.linear.limit = Um(127.5);
            },
            "[guard] limit_um of axis Z: found 127.5 µm, expected at most 127 µm, the largest correction",
        ),
        (
            |_, guard, _| {
                let rotary = guard.rotary.expect("stated");
                let slew_per_s = Urad(0.0);
                guard.rotary = Some(AxisSettings { slew_per_s, ..rotary });
            },
            "simulated: [guard] slew_urad_per_s of axis B: found 0 µrad/s, expected a positive number",
        ),
        (
            |_, guard, _| guard.hold = Duration::from_millis(1),
            "simulated: [guard] hold_ms: found 1 ms, expected at least one cycle",
        ),
    ];
    for (change, expected) in cases {
        let message = planned(change).expect_err(expected).to_string();
        assert!(message.contains(expected), "{message}");
    }
}

/// A rotary axis with a fixed position is rejected unless no drive turns it: its correction would be that of another position.
#[test]
fn a_fixed_rotary_axis_is_refused_unless_no_drive_turns_it() {
    let plan = |not_driven: &[AxisName], fixed: &[AxisName]| {
        planned(|description, _, path| {
            description.axes.retain(|axis| !axis.name.is_rotary());
            path.not_driven.extend(not_driven);
            let at = |name: AxisName| Displacement::from_coordinate(name.kind(), 10.0);
            path.fixed.extend(fixed.iter().map(|name| (*name, at(*name))));
        })
    };
    let [b, c] = [AxisName::B, AxisName::C];
    let refused = plan(&[b], &[b, c]).expect_err("C is driven");
    assert!(matches!(refused, PlanError::FixedRotary { axis, .. } if axis == c));
    assert!(refused.to_string().contains("of a controller that shows its position"), "{refused}");
    assert!(plan(&[b, c], &[b, c]).is_ok());
    for (not_driven, fixed) in [(&[b, c][..], &[b][..]), (&[AxisName::X], &[])] {
        let refused = plan(not_driven, fixed).expect_err("nothing is stated of it");
        assert!(matches!(refused, PlanError::NotDriven { .. }), "{refused}");
    }
}

#[test]
fn a_fixed_position_beyond_the_travel_is_refused() {
    let fixed = |at: f64| {
        planned(|description, _, path| {
            description.axes.retain(|axis| axis.name != AxisName::Z);
            path.fixed.insert(AxisName::Z, Displacement::Length(Mm(at)));
        })
    };
    let machine = machine();
    let [low, high] = machine.axis(AxisName::Z).expect("an axis").travel;
    for at in [low, high] {
        assert!(fixed(at).is_ok(), "{at}: {:?}", fixed(at));
    }
    for at in [1e12, low - 1.0, high + 1.0] {
        let error = fixed(at).expect_err("beyond");
        assert!(matches!(error, PlanError::FixedBeyond { axis: AxisName::Z, .. }));
        let expected = format!(
            "simulated: fixed: axis Z: found {at} mm, expected a position within its travel, {low} to {high} mm"
        );
        assert_eq!(error.to_string(), expected);
    }
}

#[test]
fn a_cycle_needs_a_path() {
    let guard = guard();
    let model = Model::new(&machine(), guard.fading).expect("shipped");
    let cycle = cycle_of(model, &guard, Vec::new());
    assert!(matches!(cycle.err(), Some(PlanError::Paths { found: 0 })));
}

/// Invalid periods, and periods other than planned, are rejected.
#[test]
fn a_cycle_has_the_period_of_its_plan() {
    for period in
        [Duration::ZERO, Duration::from_nanos(1), Duration::from_secs(3600), Duration::MAX]
    {
        let guard = GuardSettings { hold: Duration::MAX, zero_after: Duration::MAX, ..guard() };
        let model = Model::new(&machine(), guard.fading).expect("shipped");
        let described = control([0.0; 5], &Clock::manual()).description().clone();
        let settings = alone();
        let refused = PathPlan::new(described, &model, &guard, &settings, period);
        assert!(
            matches!(
                &refused,
                Err(PlanError::Limits { source, .. }) if [Quantity::Period, Quantity::Hold].contains(&source.what)
            ) || matches!(&refused, Err(PlanError::CycleTooShort { .. })),
            "{refused:?}"
        );
        let fits = planned(|_, _, _| {}).expect("fits");
        let control = control([0.0; 5], &Clock::manual());
        let paths = vec![ControlPath::new(Box::new(control), &fits).expect("fits")];
        let sensors = Sensors::new(Vec::new(), guard.temperatures);
        let cycle = Cycle::new(Box::new(model), paths, guard.hand_back, sensors, period);
        let refused = cycle.err();
        assert!(
            matches!(
                refused,
                Some(PlanError::Period { found, planned, .. }) if found == period && planned == PERIOD
            ),
            "{refused:?}"
        );
    }
}

#[test]
fn invalid_limits_are_refused() {
    let mut rig = Rig::at([0.0; 5]);
    let good = planned(|_, _, _| {}).expect("fits").limits;
    assert_eq!(rig.cycle.set_limits(0, &good), Ok(()));
    let mut wrong = good;
    wrong.axes[1].limit = f64::NAN;
    let refused = rig.cycle.set_limits(0, &wrong).expect_err("no number");
    assert!(matches!(
        refused,
        OrderRefusal::Limits { path: 0, source } if source.what == Quantity::Limit && source.axis.is_some_and(|(place, _)| place == 1)
    ));
    let mut fewer = good;
    fewer.count -= 1;
    assert!(matches!(
        rig.cycle.set_limits(0, &fewer),
        Err(OrderRefusal::Limits { source, .. }) if source.what == Quantity::Axes
    ));
    // Another step than that of the open controller would change the meaning of every count.
    let mut finer = good;
    finer.axes[0].resolution *= 0.1;
    assert!(matches!(
        rig.cycle.set_limits(0, &finer),
        Err(OrderRefusal::Limits { source, .. }) if source.what == Quantity::Resolution
    ));
    let missing = rig.cycle.set_limits(1, &good);
    assert_eq!(missing, Err(OrderRefusal::NoSuchPath { path: 1, paths: 1 }));
    // Messages count paths from 1.
    assert_eq!(
        missing.unwrap_err().to_string(),
        "limits of path 2: found no such path, expected 1 to 1"
    );
}

/// Rejected limits, and a rejected model with another axis order, change neither state nor correction.
#[test]
fn refused_limits_change_nothing() {
    let mut rig = Rig::at([-100.0, 40.0, 200.0, 50.0, 300.0]);
    let before = rig.arm(2000);
    assert_eq!(before.state, State::Compensating);
    let mut limits = rig.limits;
    limits.count = 2;
    assert!(rig.cycle.set_limits(0, &limits).is_err());
    // The axes of a path keep their indices: Y would get the correction of Z, and Z that of Y.
    let text = machine_file().replace("w C' X' b Y Z B t", "w C' X' b Z Y B t");
    let other = Machine::parse(&text, "other").expect("valid");
    let model = Model::new(&other, guard().fading).expect("compiles");
    let mut replacement = Replacement::new(Box::new(model), &[]);
    let refused = rig.cycle.swap_model(&mut replacement);
    assert_eq!(refused, Err(OrderRefusal::OtherAxes));
    let after = rig.run(2000);
    assert_eq!((after.state, after.correction), (before.state, before.correction));
}

#[test]
fn a_position_step_has_the_kind_of_its_axis() {
    for step in [
        Displacement::from_micro(AxisName::C.kind(), 1.0),
        Displacement::Length(Mm(-1.0)),
        Displacement::Length(Mm(f64::NAN)),
    ] {
        let refused = planned(|_, _, path| path.position_steps = [(AxisName::X, step)].into());
        assert!(
            matches!(refused, Err(PlanError::PositionStep { axis: AxisName::X, .. })),
            "{refused:?}"
        );
    }
}

/// Y corrects only with the new machine file, and without a barrier by at most 30 µm.
#[test]
fn an_axis_that_a_new_model_corrects_keeps_to_the_limit_without_a_barrier() {
    let text = "structure = \"w X' Y' b Z t\"
axes = { X.travel = [0, 100], Y.travel = [0, 500], Z.travel = [0, 400] }
errors = { EYY = 1000, EXX = 280 }";
    let only_x = format!("correct = [\"X\"]\n{text}");
    let mut settings = GuardSettings::new(AxisSettings::new(Um(250.0), Um(500.0)));
    settings.rotary = Some(AxisSettings::new(Urad(250.0), Urad(500.0)));
    settings.without_barrier = WithoutBarrier { linear: Um(30.0), rotary: Urad(30.0) };
    let machine = Machine::parse(&only_x, "m").expect("valid");
    let names = [AxisName::X, AxisName::Y, AxisName::Z];
    let mut rig = Rig::with(&machine, &settings, &names, &[100.0, 200.0, 0.0]);
    let report = rig.arm(1500);
    assert_eq!(report.state, State::Compensating);
    let [x, y] = [AxisName::X, AxisName::Y].map(|name| machine.index_of(name).expect("an axis"));
    assert!(report.correction[x].abs() > 0.025 && report.correction[x].abs() <= 0.030 + 1e-9);
    assert_eq!(report.correction[y], 0.0);
    let all = Machine::parse(text, "m").expect("valid");
    rig.swap(&all);
    rig.step(Some(Request::Switched));
    let report = rig.run(1500);
    assert!(
        report.correction[y].abs() <= 0.030 + 1e-9,
        "Y has {} mm without a barrier",
        report.correction[y]
    );
}

/// For an axis that does not correct, a limit beyond the range of its device is reduced instead of rejected.
#[test]
fn an_axis_that_does_not_correct_respects_the_range_of_its_device() {
    let text = "correct = [\"X\"]
structure = \"w X' Y' b Z t\"
axes = { X.travel = [0, 100], Y.travel = [0, 500], Z.travel = [0, 400] }
errors = { EYY = 1000, EXX = 280 }";
    let machine = Machine::parse(text, "m").expect("valid");
    let model = Model::new(&machine, Fading::default()).expect("compiles");
    let mut description = without_barrier("one", &[AxisName::X, AxisName::Y, AxisName::Z]);
    description.axes[1].largest = Some(Displacement::Length(Mm(0.1)));
    let plan = PathPlan::new(description, &model, &guard(), &alone(), PERIOD).expect("fits");
    let limits = plan.limits.axes.map(|axis| [axis.limit, axis.warn]);
    assert!((limits[0][0] - 0.25).abs() < 1e-12, "{limits:?}");
    assert!((limits[1][0] - 0.1).abs() < 1e-12 && limits[1][1] <= 0.1, "{limits:?}");
}
