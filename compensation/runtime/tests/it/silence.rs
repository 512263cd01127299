//! A control that sends cyclically becomes silent, and its driver repeats the last message with its age. Only the guard decides what is
//! too old, by `hold` and `zero_after`.

use std::time::Duration;

use volcomp_port::{Clock, Description, Fault, Snapshot};
use volcomp_runtime::{
    AxisSettings, Cycle, GuardSettings, Report,
    guard::{Hold, Interlock, Reasons, Request, State},
};
use volcomp_vocabulary::{PerChannel, Um};

use crate::{
    rig::{PERIOD, alone, referenced, without_barrier},
    ways::{AXES, Plant, Ways, three_axes},
};

const HOLD: Duration = Duration::from_millis(60);
const ZERO_AFTER: Duration = Duration::from_millis(700);

/// Messages of the control that have stopped.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Silent {
    positions: bool,
    state: bool,
    correction: bool,
}

const NONE: Silent = Silent { positions: false, state: false, correction: false };
const ALL: Silent = Silent { positions: true, state: true, correction: true };

#[derive(Default)]
struct Control {
    silent: Silent,
    words: PerChannel<f64>,
    came: Option<Snapshot>,
}

impl Plant for Control {
    fn read(&mut self, _: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        let sends = referenced(PerChannel::ZERO, clock.now(), Some(self.words));
        let mut reported = self.came.unwrap_or(sends);
        if !self.silent.positions {
            (reported.positions, reported.taken) = (sends.positions, sends.taken);
        }
        if !self.silent.state {
            (reported.state, reported.state_taken) = (sends.state, sends.state_taken);
        }
        if !self.silent.correction {
            (reported.applied, reported.correction_taken) = (sends.applied, sends.correction_taken);
        }
        self.came = Some(reported);
        Ok(reported)
    }

    fn apply(
        &mut self,
        _: &Description,
        corrections: &PerChannel<f64>,
        _: &Clock,
    ) -> Result<(), Fault> {
        self.words = *corrections;
        Ok(())
    }
}

struct Scene {
    ways: Ways<Control>,
    cycle: Cycle,
}

impl Scene {
    /// A compensating scene with 25 µm on X.
    fn new() -> Self {
        let mut guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
        (guard.hold, guard.zero_after) = (HOLD, ZERO_AFTER);
        guard.ramp = Duration::from_millis(200);
        let model = three_axes("EXX = { poly = [-25, 0.5] }", &guard);
        let ways = Ways::to(Control::default(), Clock::manual());
        let path = ways.path(without_barrier("can", &AXES), &model, &guard, &alone());
        let cycle = ways.cycle(model, &guard, vec![path]).expect("one path");
        let mut scene = Self { ways, cycle };
        scene.run(Duration::from_millis(200));
        scene.ways.step(&mut scene.cycle, Some(Request::Arm));
        let report = scene.run(Duration::from_secs(2));
        assert_eq!((report.state, scene.x_um()), (State::Compensating, 25.0));
        scene
    }

    fn run(&mut self, time: Duration) -> Report {
        let cycles = time.as_nanos().div_ceil(PERIOD.as_nanos());
        for _ in 1..cycles {
            self.ways.step(&mut self.cycle, None);
        }
        self.ways.step(&mut self.cycle, None)
    }

    fn x_um(&self) -> f64 {
        (self.ways.plant().words[0] * 1e3).round()
    }

    fn set(&self, silent: Silent) {
        self.ways.plant().silent = silent;
    }

    /// Runs until the stopped messages are older than `hold`, then checks the state.
    fn holds(&mut self, silent: Silent, expected: State) -> Report {
        self.set(silent);
        let last = self.run(HOLD);
        assert_eq!(last.state, State::Compensating, "{silent:?}");
        let report = self.run(PERIOD);
        assert_eq!(report.state, expected, "{silent:?}: {:?}", report.reasons);
        assert_eq!(self.x_um(), 25.0, "{silent:?}");
        report
    }

    /// Runs for `time`, then checks the state and the correction of X, µm.
    #[track_caller]
    fn runs_to(&mut self, time: Duration, state: State, x_um: f64) {
        let report = self.run(time);
        assert_eq!((report.state, self.x_um()), (state, x_um));
    }

    fn comes_back(&mut self) {
        self.set(NONE);
        self.runs_to(Duration::from_secs(2), State::Compensating, 25.0);
    }
}

/// With stale positions the correction is held after `hold`, ramps out after `zero_after`, and ramps in with the next positions.
#[test]
fn stale_positions_are_held_and_ramped_out() {
    let mut scene = Scene::new();
    let positions = true;
    let report = scene.holds(Silent { positions, ..NONE }, State::Holding(Hold::Stale));
    assert!(report.reasons.contains(Reasons::POSITIONS_STALE));
    scene.runs_to(ZERO_AFTER.saturating_sub(HOLD + PERIOD), State::Holding(Hold::Stale), 25.0);
    scene.runs_to(Duration::from_secs(1), State::Holding(Hold::Lost), 0.0);
    scene.comes_back();
}

/// With stale interlock flags every flag forbids correction from `hold` on, until it is reported again.
#[test]
fn stale_flags_forbid() {
    let mut scene = Scene::new();
    let interlocked = State::Holding(Hold::Interlocked);
    let report = scene.holds(Silent { state: true, ..NONE }, interlocked);
    for reason in Interlock::REASONS {
        assert!(report.reasons.contains(reason), "{:?}", report.reasons);
    }
    scene.runs_to(Duration::from_secs(3), interlocked, 25.0);
    scene.comes_back();
}

/// A stale read-back holds the correction with the reason `UNCONFIRMED`, without a fault, because no reading contradicts it.
#[test]
fn a_stale_read_back_confirms_nothing() {
    let mut scene = Scene::new();
    let (correction, unconfirmed) = (true, State::Holding(Hold::Unconfirmed));
    let report = scene.holds(Silent { correction, ..NONE }, unconfirmed);
    assert!(report.reasons.contains(Reasons::UNCONFIRMED));
    scene.runs_to(Duration::from_secs(3), unconfirmed, 25.0);
    scene.comes_back();
}

#[test]
fn a_control_that_only_repeats_itself_does_not_answer() {
    let mut scene = Scene::new();
    let report = scene.holds(ALL, State::Holding(Hold::Stale));
    assert!(report.reasons.contains(Reasons::NO_CONTROLLER));
    let report = scene.run(Duration::from_secs(3));
    let state = report.state;
    assert!(matches!(state, State::Holding(_) | State::RampingOut(_)));
    let answered = report.paths[0].answered;
    assert!(answered.is_some_and(|ago| ago > Duration::from_secs(3)));
    scene.comes_back();
}
