//! A path that carries the correction of thermal terms alone, for a slow control.

use std::time::Duration;

use volcomp_guard::SensorLimits;
use volcomp_model::{Fading, Machine};
use volcomp_port::{Clock, Temperature, published, simulated};
use volcomp_runtime::{
    AxisSettings, Cycle, GuardSettings, Model, PathPlan, PathSettings, PlanError, Report, Sensors,
    guard::{LimitsError, Quantity, Request, State},
};
use volcomp_vocabulary::{AxisName, PerChannel, Um};

use crate::rig::{Injected, PERIOD, alone, path_of, simulated_control, step, without_barrier};

const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
const SECOND: u32 = 250;
/// X is 15 µm off whatever the temperature is, Z by 2 µm for each kelvin.
const ERRORS: &str = "errors = { EXX = 15.0 }\n";
const THERMAL: &str =
    "[[thermal.drift]]\nerror = \"EZZ\"\nsensors = { bed = 1.0 }\num_per_k = 2.0\n";

fn model(parts: [&str; 2]) -> Model {
    let text = format!(
        "structure = \"w X' b Y Z t\"\naxes = {{ X.travel = [0, 800], Y.travel = [0, 400], Z.travel = [0, 250] }}\n{}",
        parts.concat()
    );
    let machine = Machine::parse(&text, "m").expect("valid");
    Model::new(&machine, Fading::default()).expect("compiles")
}

fn settings(hold: Duration) -> PathSettings {
    PathSettings {
        only_thermal: true,
        hold: Some(hold),
        ..alone()
    }
}

/// Runs a path for 10 s at 25 °C, and then for 3 s in which the control does not answer. The reports at both ends.
fn run(settings: &PathSettings) -> [Report; 2] {
    let (model, clock) = (model([ERRORS, THERMAL]), Clock::manual());
    let stands = simulated::Move {
        to: PerChannel::ZERO,
        feed_per_s: 1.0,
        dwell: Duration::from_secs(3600),
    };
    let injected = Injected::default();
    let control = injected.disturb(simulated_control(&AXES, vec![stands], &clock));
    let guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    let (path, _) = path_of(control, &model, &guard, settings);
    let (mut publisher, thermometer) = published("t", vec!["bed".to_owned()]);
    let sensors = Sensors::new(vec![Box::new(thermometer)], SensorLimits::default());
    let paths = vec![path];
    let cycle = Cycle::new(Box::new(model), paths, guard.hand_back, sensors, PERIOD);
    let mut cycle = cycle.expect("one path").with_clock(clock.clone());
    let mut run = |seconds: u32, request: Option<Request>| {
        for k in 0..seconds * SECOND {
            if k % SECOND == 0 {
                publisher.publish(&[Temperature::good(25.0, clock.now())]);
            }
            step(&mut cycle, &clock, request.filter(|_| k == SECOND));
        }
        *cycle.report()
    };
    let heard = run(10, Some(Request::Arm));
    injected.set_silent(true);
    [heard, run(3, None)]
}

#[test]
fn a_path_for_thermal_terms_carries_these_alone_and_holds_longer() {
    let um = |report: &Report| report.correction.map(|mm| (mm * 1e3).round());
    let [heard, silent] = run(&alone());
    assert_eq!(um(&heard)[..3], [-15.0, 0.0, -10.0], "all terms");
    assert!(
        matches!(silent.state, State::Holding(_) | State::RampingOut(_)),
        "{:?}",
        silent.state
    );
    let [heard, silent] = run(&settings(Duration::from_secs(5)));
    for report in [&heard, &silent] {
        assert_eq!(um(report)[..3], [0.0, 0.0, -10.0]);
        assert_eq!(report.state, State::Compensating, "{:?}", report.reasons);
    }
    // What is left of the error is told as it is.
    let left = heard.residual.expect("positions are known").position_mm[0];
    assert!((left - 0.015).abs() < 1e-6, "{left}");
}

#[test]
fn five_seconds_are_the_ceiling_and_only_for_thermal_terms() {
    let guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    let planned = |model: &Model, settings: &PathSettings| {
        let description = without_barrier("control", &AXES);
        PathPlan::new(description, model, &guard, settings, PERIOD)
    };
    let thermal = model([ERRORS, THERMAL]);
    let five = Duration::from_secs(5);
    let plan = planned(&thermal, &settings(five)).expect("fits");
    assert_eq!((plan.limits.hold, plan.limits.zero_after), (five, five));
    let all_terms = PathSettings {
        only_thermal: false,
        ..settings(Duration::from_millis(201))
    };
    for settings in [settings(five + PERIOD), all_terms] {
        let refused = planned(&thermal, &settings).expect_err("too long");
        assert!(
            matches!(
                refused,
                PlanError::Limits {
                    source: LimitsError {
                        what: Quantity::Hold,
                        ..
                    },
                    ..
                }
            ),
            "{refused}"
        );
    }
    let refused = planned(&model([ERRORS, ""]), &settings(five)).expect_err("no thermal terms");
    assert!(
        matches!(refused, PlanError::NoThermalTerms { .. }),
        "{refused}"
    );
}
