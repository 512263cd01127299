//! Two ways to one control, and a third controller that alone tells where Z is and falls silent: positions are old for both
//! ways, which both answer.

use std::{
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use volcomp_model::Machine;
use volcomp_port::{
    Axis, Clock, Controller, ControllerState, Description, Fault, Heartbeat, ShownStates, Snapshot,
};
use volcomp_runtime::{
    Asked, AxisSettings, ControlPath, Cycle, GuardSettings, Model, PathPlan, PathSettings,
    PositionReader, ReaderPlan, Sensors,
    guard::{Hold, Request, State},
};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerChannel, Um};

use crate::rig::PERIOD;

const MACHINE: &str = "structure = \"w X' Y' b Z t\"
axes = { X.travel = [0, 100], Y.travel = [0, 500], Z.travel = [0, 400] }
errors = { EXX = { poly = [-25, 0.5] } }";

/// The control, and whether the scale of Z answers.
#[derive(Default)]
struct Plant {
    word: PerChannel<f64>,
    is_scale_silent: bool,
    /// For how long a scale that is silent keeps whoever asks.
    hangs: Duration,
}

/// A way to the control, or to the scale, which is never written to.
struct Way {
    plant: Arc<Mutex<Plant>>,
    clock: Clock,
    description: Description,
}

impl Controller for Way {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _: Instant) -> Result<Snapshot, Fault> {
        let plant = self.plant.lock().unwrap_or_else(PoisonError::into_inner);
        let is_scale = self.description.axes.is_empty();
        if is_scale && plant.is_scale_silent {
            let hangs = plant.hangs;
            drop(plant);
            std::thread::sleep(hangs);
            return Err(Fault::TimedOut);
        }
        let mut positions = PerChannel::ZERO;
        if !is_scale {
            positions[0] = 30.0;
        }
        Ok(Snapshot {
            positions,
            taken: self.clock.now(),
            uncertainty: Duration::ZERO,
            state: ControllerState {
                referenced: true,
                alarm: false,
                emergency_stop: false,
            },
            applied: (!is_scale).then_some(plant.word),
            report: None,
        })
    }

    fn apply(&mut self, correction: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        let mut plant = self.plant.lock().unwrap_or_else(PoisonError::into_inner);
        plant.word = *correction;
        Ok(())
    }
}

fn description(name: &str) -> Description {
    let axis = |name| Axis {
        name,
        includes_correction: false,
        resolution: Displacement::Length(Mm(0.001)),
        largest: None,
    };
    Description {
        device: name.to_owned(),
        channel: "one".to_owned(),
        axes: [AxisName::X, AxisName::Y].map(axis).to_vec(),
        reads: Vec::new(),
        heartbeat: Heartbeat::Watched,
        barrier: false,
        tells_applied: true,
        shown: ShownStates::ALL,
        sees_other_gateways: true,
        shortest_cycle: Duration::from_millis(1),
    }
}

/// Cycles after which the scale falls silent.
const SILENT_AT: u32 = 1000;

/// A cycle with both ways and the scale.
fn cycle(clock: &Clock, plant: &Arc<Mutex<Plant>>) -> Cycle {
    let mut guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    let machine = Machine::parse(MACHINE, "m").expect("valid");
    let model = Model::new(&machine, guard.fading).expect("compiles");
    let settings = PathSettings {
        watch: Duration::ZERO,
        ..PathSettings::default()
    };
    let way = |description: Description| Way {
        plant: Arc::clone(plant),
        clock: clock.clone(),
        description,
    };
    let paths = ["first", "second"].map(|name| {
        let plan = PathPlan::new(description(name), &model, &guard, &settings, PERIOD);
        let way = way(description(name));
        ControlPath::new(Box::new(way), &plan.expect("fits")).expect("fits")
    });
    let scale = Description {
        axes: Vec::new(),
        reads: vec![AxisName::Z],
        tells_applied: false,
        ..description("scale")
    };
    let plan = ReaderPlan::new(scale.clone(), &model, &settings).expect("fits");
    let reader = PositionReader::new(Box::new(way(scale)), &plan);
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    let cycle = Cycle::new(
        Box::new(model),
        paths.into(),
        guard.hand_back,
        sensors,
        PERIOD,
    );
    let cycle = cycle.expect("fits").with_clock(clock.clone());
    cycle.with_readers(vec![reader]).expect("room")
}

/// Runs 3000 cycles with a request in one of them. How often the ways changed, the state at the end, and the word of X (µm)
/// in some cycles.
fn run(disarm_at: u32, look_at: [u32; 3]) -> (u32, State, [f64; 3]) {
    let (clock, plant) = (Clock::manual(), Arc::new(Mutex::new(Plant::default())));
    let mut cycle = cycle(&clock, &plant);
    let (mut changes, mut active, mut words) = (0, 0, [f64::NAN; 3]);
    for n in 0..3000 {
        clock.advance(PERIOD);
        let mut told = plant.lock().unwrap_or_else(PoisonError::into_inner);
        told.is_scale_silent = n >= SILENT_AT;
        let word_um = told.word[0] * 1e3;
        drop(told);
        let asked = Asked {
            request: match n {
                5 => Some(Request::Arm),
                _ if n == disarm_at => Some(Request::Disarm),
                _ => None,
            },
            ..Asked::default()
        };
        cycle.run(clock.now(), &asked, &mut || Duration::ZERO);
        let report = cycle.report();
        changes += u32::from(report.active != active);
        active = report.active;
        for (word, at) in words.iter_mut().zip(look_at) {
            if n == at {
                *word = word_um;
            }
        }
    }
    (changes, cycle.report().state, words)
}

/// Positions that are lost ramp the correction out. Before, the ways changed in every cycle and each change began the ramp
/// anew: 10 µm stayed for good.
#[test]
fn positions_that_are_old_on_both_ways_ramp_the_correction_out() {
    let (changes, state, words) = run(u32::MAX, [SILENT_AT, SILENT_AT + 300, 2999]);
    assert_eq!(state, State::Holding(Hold::Lost));
    assert!((words[0].abs() - 10.0).abs() < 1.0, "{words:?}");
    assert_eq!(words[1..], [0.0; 2], "after 1.2 s");
    assert!(changes <= 1, "{changes} changes");
}

/// Disarming takes the correction out in the time of a ramp, whatever the positions are.
#[test]
fn disarming_while_positions_are_old_takes_the_correction_out() {
    let (changes, state, words) = run(SILENT_AT + 30, [SILENT_AT, SILENT_AT + 30, SILENT_AT + 130]);
    assert_eq!(state, State::Disarmed);
    assert!((words[1].abs() - 10.0).abs() < 1.0, "{words:?}");
    assert_eq!(words[2], 0.0);
    assert!(changes <= 1, "{changes} changes");
}

/// The scale keeps whoever asks it for two seconds. Before, the cycle waited for it, and so did disarming.
#[test]
fn a_controller_that_is_only_read_and_hangs_costs_no_cycle() {
    let (clock, plant) = (Clock::system(), Arc::new(Mutex::new(Plant::default())));
    let mut cycle = cycle(&clock, &plant);
    cycle.attend_standbys().expect("threads");
    let mut longest = Duration::ZERO;
    for n in 0..400 {
        std::thread::sleep(PERIOD);
        let mut told = plant.lock().unwrap_or_else(PoisonError::into_inner);
        (told.is_scale_silent, told.hangs) = (n >= 250, Duration::from_secs(2));
        drop(told);
        let asked = Asked {
            request: match n {
                5 => Some(Request::Arm),
                260 => Some(Request::Disarm),
                _ => None,
            },
            ..Asked::default()
        };
        let begun = Instant::now();
        cycle.run(clock.now(), &asked, &mut || Duration::ZERO);
        longest = longest.max(begun.elapsed());
        if n == 249 {
            assert!(cycle.report().state.is_armed(), "{:?}", cycle.report());
        }
    }
    assert_eq!(cycle.report().state, State::Disarmed);
    let word = plant.lock().unwrap_or_else(PoisonError::into_inner).word[0];
    assert_eq!(word, 0.0);
    assert!(longest < Duration::from_millis(500), "{longest:?}");
}
