//! Thermal terms: their lags after a pause of the program or a reload of the machine file, and a path for thermal terms only.

use std::time::Duration;

use volcomp_guard::{Reasons, SensorLimits};
use volcomp_kinematics::State;
use volcomp_model::{Fading, Machine};
use volcomp_port::{Clock, Publisher, Temperature, published, simulated};
use volcomp_runtime::{
    AxisSettings, Cycle, GuardSettings, Model, PathPlan, PathSettings, PlanError, Report, Sensors,
    WithoutBarrier,
    guard::{LimitsError, Quantity, Request, State as GuardState},
};
use volcomp_vocabulary::{Mm, PerChannel, Um, Urad};

use crate::{
    rig::{Injected, PERIOD, alone, path_of, simulated_control, step, without_barrier},
    ways::AXES,
};

fn model(lag_s: f64, weight: f64) -> Model {
    let text = format!(
        "structure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n[[thermal.drift]]\nerror = \"EZZ\"\nsensors = {{ spindle = {weight:?} }}\num_per_k = 10.0\nlag_s = {lag_s:?}\n"
    );
    let machine = Machine::parse(&text, "m").expect("valid");
    Model::new(&machine, Fading::default()).expect("compiles")
}

/// A cycle on a simulated control with one thermometer and a manual clock.
struct Rig {
    cycle: Cycle,
    publisher: Publisher,
    clock: Clock,
    control: Injected,
}

impl Rig {
    fn new(model: Model, limit: f64, settings: &PathSettings) -> Self {
        let clock = Clock::manual();
        let stands = simulated::Move {
            to: PerChannel([100.0; 9]),
            feed_per_s: 100.0,
            dwell: Duration::from_secs(100_000),
        };
        let injected = Injected::default();
        let control = injected.disturb(simulated_control(&AXES, vec![stands], &clock));
        let guard = GuardSettings {
            without_barrier: WithoutBarrier { linear: Um(limit), rotary: Urad(30.0) },
            ..GuardSettings::new(AxisSettings::new(Um(limit), Um(500.0)))
        };
        let (path, _) = path_of(control, &model, &guard, settings);
        let (publisher, thermometer) = published("t", vec!["spindle".to_owned()]);
        let limits = SensorLimits { stuck_after: None, ..SensorLimits::default() };
        let sensors = Sensors::new(vec![Box::new(thermometer)], limits);
        let paths = vec![path];
        let cycle = Cycle::new(Box::new(model), paths, guard.hand_back, sensors, PERIOD);
        Self {
            cycle: cycle.expect("fits").with_clock(clock.clone()),
            publisher,
            clock,
            control: injected,
        }
    }

    /// Runs at this temperature. Returns the requested correction of Z, µm.
    fn run(&mut self, seconds: u32, degc: f64) -> f64 {
        // The thermometer is read in the middle of each second, so its reading is old after a pause.
        for k in 0..seconds * 250 {
            if k % 250 == 125 {
                let now = self.clock.now();
                self.publisher.publish(&[Temperature::good(degc, now)]);
            }
            step(&mut self.cycle, &self.clock, None);
        }
        self.cycle.report().wanted[2] * 1e3
    }

    fn says(&self, reason: Reasons) -> bool {
        self.cycle.report().reasons.contains(reason)
    }
}

/// Requested correction of Z (µm) 14 minutes after the spindle began to warm up by 4 K in two minutes. If `stands`, the program is paused
/// for ten of these minutes.
fn wanted_after_warming(stands: bool) -> f64 {
    let mut rig = Rig::new(model(600.0, 1.0), 100.0, &alone());
    rig.run(2, 20.0);
    for k in 1..=8 {
        rig.run(15, 20.0 + 0.5 * f64::from(k));
    }
    if stands {
        rig.clock.advance(Duration::from_secs(600));
    } else {
        rig.run(600, 24.0);
    }
    rig.run(4, 24.0)
}

#[test]
fn temperatures_beyond_the_tested_range_are_reported() {
    let text = model(0.0, 1.0).text
        + "[[thermal.seen]]\nerror = \"EZZ\"\nsensor = \"spindle\"\ndegc = [19.0, 22.0]\n";
    // The checksum is that of the unmodified text.
    let lines = text.lines().filter(|line| !line.starts_with("checksum"));
    let text: String = lines.map(|line| line.to_owned() + "\n").collect();
    let machine = Machine::parse(&text, "m").expect("valid");
    let fading = Fading { fade_s: 20.0, ..Fading::default() };
    let warming = Model::new(&machine, fading).expect("compiles");
    let mut rig = Rig::new(warming, 100.0, &alone());
    // Steps of 0.5 K do not count as jumps.
    rig.run(2, 20.0);
    rig.run(15, 20.5);
    let inside = rig.run(15, 21.0);
    assert!((inside + 10.0).abs() < 0.01, "{inside} µm");
    assert!(!rig.says(Reasons::BEYOND_SEEN));
    for degc in [21.5, 22.0, 22.5] {
        rig.run(15, degc);
    }
    // 1 K beyond the range, where the term fades over 5 K: 4/5 of 20 µm.
    let beyond = rig.run(40, 23.0);
    assert!((beyond + 16.0).abs() < 0.01, "{beyond} µm");
    assert!(rig.says(Reasons::BEYOND_SEEN) && !rig.says(Reasons::DEGRADED));
    rig.run(15, 22.5);
    let back = rig.run(40, 22.0);
    assert!((back + 20.0).abs() < 0.01, "{back} µm");
    assert!(!rig.says(Reasons::BEYOND_SEEN));
}

#[test]
fn thermal_lags_include_the_time_of_a_paused_program() {
    let (runs, stood) = (wanted_after_warming(false), wanted_after_warming(true));
    assert!(runs < -20.0, "{runs} µm");
    assert!((runs - stood).abs() < 0.5, "{runs} µm, {stood} µm");
}

/// A reload while the spindle warms up changes a lag by a second or a weight by 0.1 %: Z moves by less than 0.02 µm.
#[test]
fn a_reload_that_changes_a_lag_does_not_move_the_axes() {
    let z_um = |model: &Model| model.correction(&State::default()).delta[2] * 1e3;
    for (lag_s, weight) in [(600.0, 1.0), (601.0, 1.0), (600.0, 1.001)] {
        let mut old = model(600.0, 1.0);
        old.step(0.0, &[Some(20.0)]);
        for _ in 0..100 {
            old.step(1.0, &[Some(26.0)]);
        }
        let mut new = model(lag_s, weight);
        new.carry_over(&old);
        new.step(0.004, &[Some(26.0)]);
        let (before, after) = (z_um(&old), z_um(&new));
        assert!(before < -9.0, "{before} µm");
        assert!((before - after).abs() < 0.02, "{before} µm, {after} µm");
    }
}

/// A removed term whose sensor has cooled while its lag is still warm: the reported change is 0.06 mm now, and zero in the steady state.
#[test]
fn a_change_is_judged_with_the_present_lags() {
    let cold = |_: &str| Some(20.0);
    let mut running = model(3600.0, 1.0);
    running.step(0.0, &[Some(26.0)]);
    running.step(1.0, &[Some(20.0)]);
    let machine = Machine::parse(
        "structure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n",
        "m",
    );
    let old = model(3600.0, 1.0);
    let new = Model::new(&machine.expect("valid"), Fading::default()).expect("compiles");
    let settled = old.warmed(cold).largest_move(&new.warmed(cold), []);
    assert!(settled.linear < Mm(1e-6), "{}", settled.linear);
    let now = |model: &Model| model.in_place_of(&running, cold);
    let moved = now(&old).largest_move(&now(&new), []).linear;
    assert!((moved - Mm(0.06)).abs() < Mm(1e-4), "{moved}");
}

/// X is off by 15 µm at any temperature, Z by 2 µm/K.
const ERRORS: &str = "errors = { EXX = 15.0 }\n";
const THERMAL: &str =
    "[[thermal.drift]]\nerror = \"EZZ\"\nsensors = { spindle = 1.0 }\num_per_k = 2.0\n";

fn terms(parts: [&str; 2]) -> Model {
    let text = format!(
        "structure = \"w X' b Y Z t\"\naxes = {{ X.travel = [0, 800], Y.travel = [0, 400], Z.travel = [0, 250] }}\n{}",
        parts.concat()
    );
    let machine = Machine::parse(&text, "m").expect("valid");
    Model::new(&machine, Fading::default()).expect("compiles")
}

fn settings(hold: Duration) -> PathSettings {
    PathSettings { only_thermal: true, hold: Some(hold), ..alone() }
}

/// Runs a path for 10 s at 25 °C, then for 3 s in which the control does not answer; returns the reports at both ends.
fn run(settings: &PathSettings) -> [Report; 2] {
    let mut rig = Rig::new(terms([ERRORS, THERMAL]), 30.0, settings);
    rig.run(1, 25.0);
    step(&mut rig.cycle, &rig.clock, Some(Request::Arm));
    rig.run(9, 25.0);
    let received = *rig.cycle.report();
    rig.control.set_silent(true);
    rig.run(3, 25.0);
    [received, *rig.cycle.report()]
}

#[test]
fn a_path_for_thermal_terms_carries_these_alone_and_holds_longer() {
    let um = |report: &Report| report.correction.map(|mm| (mm * 1e3).round());
    let [received, silent] = run(&alone());
    assert_eq!(um(&received)[..3], [-15.0, 0.0, -10.0], "all terms");
    let state = silent.state;
    assert!(matches!(state, GuardState::Holding(_) | GuardState::RampingOut(_)));
    let [received, silent] = run(&settings(Duration::from_secs(5)));
    for report in [&received, &silent] {
        assert_eq!(um(report)[..3], [0.0, 0.0, -10.0]);
        assert_eq!(report.state, GuardState::Compensating, "{report:?}");
    }
    // The residual error is that of the whole model.
    let left = received.residual.expect("positions are known").position_mm[0];
    assert!((left - 0.015).abs() < 1e-6, "{left}");
}

#[test]
fn five_seconds_are_the_ceiling_and_only_for_thermal_terms() {
    let guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    let planned = |model: &Model, settings: &PathSettings| {
        let description = without_barrier("control", &AXES);
        PathPlan::new(description, model, &guard, settings, PERIOD)
    };
    let thermal = terms([ERRORS, THERMAL]);
    let five = Duration::from_secs(5);
    let plan = planned(&thermal, &settings(five)).expect("fits");
    assert_eq!((plan.limits.hold, plan.limits.zero_after), (five, five));
    let all_terms = PathSettings { only_thermal: false, ..settings(Duration::from_millis(201)) };
    for settings in [settings(five + PERIOD), all_terms] {
        let refused = planned(&thermal, &settings).expect_err("too long");
        assert!(
            matches!(
                refused,
                PlanError::Limits { source: LimitsError { what: Quantity::Hold, .. }, .. }
            ),
            "{refused}"
        );
    }
    let refused = planned(&terms([ERRORS, ""]), &settings(five)).expect_err("no thermal terms");
    assert!(matches!(refused, PlanError::NoThermalTerms { .. }), "{refused}");
}
