//! What the run before may have left on a path that does not answer.

use std::{
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_port::{Clock, Controller, Description, Fault, Snapshot};
use volcomp_runtime::{
    Asked, AxisSettings, ControlPath, Cycle, GuardSettings, Model, PathPlan, PathSettings, Sensors,
    guard::{Reasons, Request, State},
    machine::Machine,
};
use volcomp_vocabulary::{AxisName, PerAxis, PerChannel, Um};

use crate::rig::{referenced, without_barrier};

const PERIOD: Duration = Duration::from_millis(4);
const MACHINE: &str = "structure = \"w X' Y' b Z t\"
axes = { X.travel = [0, 100], Y.travel = [0, 500], Z.travel = [0, 400] }
errors = { EXX = { poly = [-25, 0.5] } }";

/// The correction of X, which follows whichever way wrote last, and its largest change by one write, mm.
type Plant = Arc<Mutex<(f64, f64)>>;

struct Way {
    silent: Arc<AtomicBool>,
    plant: Plant,
    clock: Clock,
    description: Description,
}

impl Controller for Way {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _: Instant) -> Result<Snapshot, Fault> {
        if self.silent.load(Ordering::Relaxed) {
            return Err(Fault::NotConnected);
        }
        let applied = PerChannel::leading([self.plant.lock().expect("fits").0]);
        let told = self.description.tells_applied.then_some(applied);
        Ok(referenced(PerChannel::ZERO, self.clock.now(), told))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        let mut plant = self.plant.lock().expect("fits");
        let change = (corrections[0] - plant.0).abs();
        *plant = (corrections[0], plant.1.max(change));
        Ok(())
    }
}

fn description(name: &str, tells_applied: bool) -> Description {
    Description {
        tells_applied,
        ..without_barrier(name, &[AxisName::X, AxisName::Y, AxisName::Z])
    }
}

/// Words that can be read back, which do not answer while this is set, and lines, each with its plant.
fn two_ways(plants: [&Plant; 2], clock: &Clock, silent: &Arc<AtomicBool>) -> Cycle {
    let guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    let model = Model::new(
        &Machine::parse(MACHINE, "left").expect("fits"),
        guard.fading,
    )
    .expect("fits");
    let names = [("words", true), ("lines", false)].into_iter().zip(plants);
    let ways = names.map(|((name, tells), plant)| {
        let description = description(name, tells);
        let settings = PathSettings::default();
        let plan =
            PathPlan::new(description.clone(), &model, &guard, &settings, PERIOD).expect("fits");
        let way = Way {
            silent: if tells {
                Arc::clone(silent)
            } else {
                Arc::default()
            },
            plant: Arc::clone(plant),
            clock: clock.clone(),
            description,
        };
        ControlPath::new(Box::new(way), &plan).expect("fits")
    });
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    let paths = ways.collect();
    Cycle::new(Box::new(model), paths, guard.hand_back, sensors, PERIOD)
        .expect("fits")
        .with_clock(clock.clone())
}

/// One cycle.
fn step(cycle: &mut Cycle, clock: &Clock, request: Option<Request>) {
    clock.advance(PERIOD);
    let asked = Asked {
        request,
        ..Asked::default()
    };
    cycle.run(clock.now(), &asked, &mut || Duration::ZERO);
}

/// Words that do not answer, and lines, with -25 µm on X. `remembered`: what was written down of X, mm. Gives the state, its
/// reasons, and the largest change of X by one write, mm.
fn run(remembered: Option<f64>, acknowledged: bool) -> (State, Reasons, f64) {
    let clock = Clock::manual();
    let applied = if remembered == Some(0.0) || acknowledged {
        0.0
    } else {
        -0.025
    };
    let plant = Arc::new(Mutex::new((applied, 0.0)));
    let silent = Arc::new(AtomicBool::new(true));
    let mut cycle = two_ways([&plant; 2], &clock, &silent);
    if let Some(x) = remembered {
        let last = PerAxis::from_fn(|axis| if axis == 0 { x } else { 0.0 });
        cycle.restore(&last, Duration::from_secs(1));
    }
    for n in 0..500 {
        let request = match n {
            50 if acknowledged => Some(Request::Acknowledge),
            100 => Some(Request::Arm),
            _ => None,
        };
        step(&mut cycle, &clock, request);
    }
    let report = cycle.report();
    (report.state, report.reasons, plant.lock().expect("fits").1)
}

/// After a restart lines took over at once from a way that was never heard, although its last output was written down as
/// -25 µm, or lost: X went from -25 to 0 µm in one write, and 0 µm was shown as applied.
#[test]
fn lines_do_not_take_over_while_a_silent_way_may_hold_a_correction() {
    for remembered in [None, Some(-0.025), Some(f64::NAN)] {
        let (state, reasons, change) = run(remembered, false);
        assert_eq!(change, 0.0, "{remembered:?}: nothing is written");
        assert_eq!(state, State::Disarmed, "{remembered:?}");
        assert!(
            reasons.contains(Reasons::OTHER_CHANNEL_UNKNOWN),
            "{reasons:?}"
        );
    }
    for (remembered, acknowledged) in [(Some(0.0), false), (None, true), (Some(-0.025), true)] {
        let (state, reasons, change) = run(remembered, acknowledged);
        assert_eq!(state, State::Compensating, "{remembered:?}: {reasons:?}");
        assert!(change <= 0.002 + 1e-9, "{remembered:?}: {change} mm");
    }
}

/// The first way corrects again, and the lines keep what they were left with: nothing told it, also not when all was disarmed.
#[test]
fn what_lines_keep_after_a_hand_back_is_told() {
    let clock = Clock::manual();
    let (words, lines) = (Plant::default(), Plant::default());
    let silent = Arc::new(AtomicBool::new(true));
    let mut cycle = two_ways([&words, &lines], &clock, &silent);
    cycle.restore(&PerAxis::ZERO, Duration::from_secs(1));
    for n in 0..500 {
        step(&mut cycle, &clock, (n == 100).then_some(Request::Arm));
    }
    let correction = |plant: &Plant| (plant.lock().expect("fits").0 * 1e3).round();
    assert_eq!((correction(&words), correction(&lines)), (0.0, 25.0));
    silent.store(false, Ordering::Relaxed);
    for _ in 0..2500 {
        step(&mut cycle, &clock, None);
    }
    assert_eq!(cycle.report().active, 0, "{:?}", cycle.report().reasons);
    assert_eq!((correction(&words), correction(&lines)), (25.0, 25.0));
    let holds = |cycle: &Cycle| cycle.report().reasons.contains(Reasons::STANDBY_HOLDS);
    assert!(holds(&cycle));
    for n in 0..500 {
        step(&mut cycle, &clock, (n == 0).then_some(Request::Disarm));
    }
    assert_eq!(cycle.report().state, State::Disarmed);
    assert_eq!((correction(&words), correction(&lines)), (0.0, 25.0));
    assert!(holds(&cycle));
}

/// The silent first way had -25 µm, which were written down. A person acknowledged the fault of before the restart, and with
/// it, unasked, that nothing was left there: X went from -25 to 0 µm in one write.
#[test]
fn who_acknowledges_a_fault_says_nothing_of_what_is_left_elsewhere() {
    let clock = Clock::manual();
    let plant = Arc::new(Mutex::new((-0.025, 0.0)));
    let silent = Arc::new(AtomicBool::new(true));
    let mut cycle = two_ways([&plant; 2], &clock, &silent);
    let left = PerAxis::from_fn(|axis| if axis == 0 { -0.025 } else { 0.0 });
    cycle.restore(&left, Duration::from_secs(1));
    for number in 0..500 {
        clock.advance(PERIOD);
        let asked = Asked {
            request: match number {
                50 => Some(Request::Acknowledge),
                100 => Some(Request::Arm),
                _ => None,
            },
            forbids: Reasons::FAULTED_BEFORE.when(number <= 50),
            ..Asked::default()
        };
        cycle.run(clock.now(), &asked, &mut || Duration::ZERO);
    }
    let largest_change = plant.lock().expect("no panic").1;
    assert!(largest_change <= 0.002 + 1e-9, "{largest_change} mm");
}
