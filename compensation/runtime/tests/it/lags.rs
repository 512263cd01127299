//! The lags of thermal terms: a program that stands, a machine file that is read again while the machine warms up.

use std::{sync::Arc, time::Duration};

use volcomp_guard::SensorLimits;
use volcomp_kinematics::State;
use volcomp_model::{Fading, Machine};
use volcomp_port::{Axis, Clock, Controller, Temperature, published, simulated};
use volcomp_runtime::{
    Asked, AxisSettings, ControlPath, Cycle, GuardSettings, Model, PathPlan, PathSettings, Sensors,
};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerChannel, Um};

use crate::rig::PERIOD;

fn model(lag_s: f64, weight: f64) -> Model {
    let text = format!(
        "structure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n[[thermal.drift]]\nerror = \"EZZ\"\nsensors = {{ spindle = {weight:?} }}\num_per_k = 10.0\nlag_s = {lag_s:?}\n"
    );
    let machine = Machine::parse(&text, "m").expect("valid");
    Model::new(&machine, Fading::default()).expect("compiles")
}

/// What is wanted of Z (µm) 14 minutes after the spindle began to warm up by 4 K, within two minutes. `stands`: the
/// program stands for ten of them.
fn wanted_after_warming(stands: bool) -> f64 {
    let (model, clock) = (model(600.0, 1.0), Clock::manual());
    let axis = |name| Axis {
        name,
        includes_correction: false,
        resolution: Displacement::Length(Mm(0.001)),
        largest: None,
    };
    let control = simulated::Machine {
        axes: [AxisName::X, AxisName::Y, AxisName::Z].map(axis).to_vec(),
        program: vec![simulated::Move {
            to: PerChannel([100.0; 9]),
            feed_per_s: 100.0,
            dwell: Duration::from_secs(100_000),
        }],
        acceleration_per_s2: 1000.0,
        sensors: Vec::new(),
        truth: Arc::new(|_, _| PerChannel::ZERO),
        clock: clock.clone(),
    };
    let (control, _, _) = control.start();
    let guard = GuardSettings::new(AxisSettings::new(Um(100.0), Um(500.0)));
    let settings = PathSettings {
        watch: Duration::ZERO,
        ..PathSettings::default()
    };
    let description = control.description().clone();
    let plan = PathPlan::new(description, &model, &guard, &settings, PERIOD).expect("fits");
    let path = ControlPath::new(Box::new(control), &plan).expect("fits");
    let (mut publisher, thermometer) = published("t", vec!["spindle".to_owned()]);
    let limits = SensorLimits {
        stuck_after: None,
        ..SensorLimits::default()
    };
    let sensors = Sensors::new(vec![Box::new(thermometer)], limits);
    let cycle = Cycle::new(
        Box::new(model),
        vec![path],
        guard.hand_back,
        sensors,
        PERIOD,
    );
    let mut cycle = cycle.expect("fits").with_clock(clock.clone());
    let mut run = |seconds: u32, degc: f64| {
        // The thermometer is read once a second, in the middle of it: after the program stood its reading is old at first.
        for k in 0..seconds * 250 {
            if k % 250 == 125 {
                publisher.publish(&[Temperature::good(degc, clock.now())]);
            }
            clock.advance(PERIOD);
            cycle.run(clock.now(), &Asked::default(), &mut || Duration::ZERO);
        }
        cycle.report().wanted[2] * 1e3
    };
    run(2, 20.0);
    for k in 1..=8 {
        run(15, 20.0 + 0.5 * f64::from(k));
    }
    if stands {
        clock.advance(Duration::from_secs(600));
    } else {
        run(600, 24.0);
    }
    run(4, 24.0)
}

/// A process that is stopped, a virtual machine that is moved: before, the lags lost the time.
#[test]
fn lags_know_of_the_time_for_which_the_program_stood() {
    let (runs, stood) = (wanted_after_warming(false), wanted_after_warming(true));
    assert!(runs < -20.0, "{runs} µm");
    assert!((runs - stood).abs() < 0.5, "{runs} µm, {stood} µm");
}

/// A machine file whose only change is the lag by a second, or a weight by a thousandth, while the spindle warms up:
/// before, Z went to its final value in the ramp of the change.
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

/// A machine file without the term whose sensor has cooled down, while the lag is still warm: cold and settled nothing
/// moves, now Z does. Before, only those two were compared.
#[test]
fn a_change_is_judged_with_the_lags_of_now() {
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
