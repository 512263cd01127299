//! The lags of thermal terms: a program that stands, a machine file that is read again while the machine warms up.

use std::time::Duration;

use volcomp_guard::{Reasons, SensorLimits};
use volcomp_kinematics::State;
use volcomp_model::{Fading, Machine};
use volcomp_port::{Clock, Publisher, Temperature, published, simulated};
use volcomp_runtime::{AxisSettings, Cycle, GuardSettings, Model, Sensors, WithoutBarrier};
use volcomp_vocabulary::{AxisName, Mm, PerChannel, Um, Urad};

use crate::rig::{PERIOD, alone, path_of, simulated_control, step};

fn model(lag_s: f64, weight: f64) -> Model {
    let text = format!(
        "structure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 250.0]\n[[thermal.drift]]\nerror = \"EZZ\"\nsensors = {{ spindle = {weight:?} }}\num_per_k = 10.0\nlag_s = {lag_s:?}\n"
    );
    let machine = Machine::parse(&text, "m").expect("valid");
    Model::new(&machine, Fading::default()).expect("compiles")
}

/// A cycle on a simulated control with one thermometer, on a clock that is counted.
struct Rig {
    cycle: Cycle,
    publisher: Publisher,
    clock: Clock,
}

impl Rig {
    fn new(model: Model) -> Self {
        let clock = Clock::manual();
        let axes = [AxisName::X, AxisName::Y, AxisName::Z];
        let stands = simulated::Move {
            to: PerChannel([100.0; 9]),
            feed_per_s: 100.0,
            dwell: Duration::from_secs(100_000),
        };
        let control = simulated_control(&axes, vec![stands], &clock);
        let guard = GuardSettings {
            without_barrier: WithoutBarrier {
                linear: Um(100.0),
                rotary: Urad(30.0),
            },
            ..GuardSettings::new(AxisSettings::new(Um(100.0), Um(500.0)))
        };
        let (path, _) = path_of(control, &model, &guard, &alone());
        let (publisher, thermometer) = published("t", vec!["spindle".to_owned()]);
        let limits = SensorLimits {
            stuck_after: None,
            ..SensorLimits::default()
        };
        let sensors = Sensors::new(vec![Box::new(thermometer)], limits);
        let paths = vec![path];
        let cycle = Cycle::new(Box::new(model), paths, guard.hand_back, sensors, PERIOD);
        let cycle = cycle.expect("fits").with_clock(clock.clone());
        Self {
            cycle,
            publisher,
            clock,
        }
    }

    /// Runs with this temperature; what is wanted of Z then, µm.
    fn run(&mut self, seconds: u32, degc: f64) -> f64 {
        // The thermometer is read once a second, in the middle of it: after the program stood its reading is old at first.
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

/// What is wanted of Z (µm) 14 minutes after the spindle began to warm up by 4 K, within two minutes. `stands`: the
/// program stands for ten of them.
fn wanted_after_warming(stands: bool) -> f64 {
    let mut rig = Rig::new(model(600.0, 1.0));
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

/// A spindle that gets warmer than in the tests of its thermal term: the cycle says so and fades the term, and takes it
/// back when the spindle is where it was tested.
#[test]
fn a_cycle_says_when_it_is_beyond_what_thermal_terms_have_seen() {
    let text = model(0.0, 1.0).text
        + "[[thermal.seen]]\nerror = \"EZZ\"\nsensor = \"spindle\"\ndegc = [19.0, 22.0]\n";
    // The checksum is that of the text before.
    let lines = text.lines().filter(|line| !line.starts_with("checksum"));
    let text: String = lines.map(|line| line.to_owned() + "\n").collect();
    let machine = Machine::parse(&text, "m").expect("valid");
    let fading = Fading {
        fade_s: 20.0,
        ..Fading::default()
    };
    let mut rig = Rig::new(Model::new(&machine, fading).expect("compiles"));
    // Half a kelvin at a time, which is no jump.
    rig.run(2, 20.0);
    rig.run(15, 20.5);
    let inside = rig.run(15, 21.0);
    assert!((inside + 10.0).abs() < 0.01, "{inside} µm");
    assert!(!rig.says(Reasons::BEYOND_SEEN));
    for degc in [21.5, 22.0, 22.5] {
        rig.run(15, degc);
    }
    // One of five kelvin beyond: four fifths of 20 µm.
    let beyond = rig.run(40, 23.0);
    assert!((beyond + 16.0).abs() < 0.01, "{beyond} µm");
    assert!(rig.says(Reasons::BEYOND_SEEN) && !rig.says(Reasons::DEGRADED));
    rig.run(15, 22.5);
    let back = rig.run(40, 22.0);
    assert!((back + 20.0).abs() < 0.01, "{back} µm");
    assert!(!rig.says(Reasons::BEYOND_SEEN));
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
