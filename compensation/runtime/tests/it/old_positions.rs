//! Two ways to one control, and a third controller that alone tells where Z is and falls silent: positions are old for both
//! ways, which both answer.

use std::time::{Duration, Instant};

use volcomp_port::{Clock, Description, Fault, Snapshot};
use volcomp_runtime::{
    AxisSettings, Cycle, GuardSettings, PositionReader, ReaderPlan,
    guard::{Hold, Request, State},
};
use volcomp_vocabulary::{AxisName, PerChannel, Um};

use crate::{
    rig::{PERIOD, alone, referenced, without_barrier},
    ways::{AXES, Plant, Ways, three_axes},
};

/// The control, and whether the scale of Z answers, which is never written to.
#[derive(Default)]
struct Control {
    word: PerChannel<f64>,
    is_scale_silent: bool,
    /// For how long a scale that is silent keeps whoever asks.
    hangs: Duration,
}

fn is_scale(way: &Description) -> bool {
    way.axes.is_empty()
}

impl Plant for Control {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        if !is_scale(way) {
            let positions = PerChannel::leading([30.0]);
            return Ok(referenced(positions, clock.now(), Some(self.word)));
        }
        if self.is_scale_silent {
            return Err(Fault::TimedOut);
        }
        Ok(referenced(PerChannel::ZERO, clock.now(), None))
    }

    fn apply(
        &mut self,
        _: &Description,
        correction: &PerChannel<f64>,
        _: &Clock,
    ) -> Result<(), Fault> {
        self.word = *correction;
        Ok(())
    }

    fn hangs(&self, way: &Description) -> Duration {
        if is_scale(way) && self.is_scale_silent {
            self.hangs
        } else {
            Duration::ZERO
        }
    }
}

/// Cycles after which the scale falls silent.
const SILENT_AT: u32 = 1000;

/// A cycle with both ways and the scale.
fn cycle(ways: &Ways<Control>) -> Cycle {
    let mut guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    let model = three_axes("EXX = { poly = [-25, 0.5] }", &guard);
    let paths = ["first", "second"].map(|name| {
        let description = without_barrier(name, &AXES[..2]);
        ways.path(description, &model, &guard, &alone())
    });
    let scale = Description {
        reads: vec![AxisName::Z],
        tells_applied: false,
        ..without_barrier("scale", &[])
    };
    let plan = ReaderPlan::new(scale.clone(), &model, &alone()).expect("fits");
    let reader = PositionReader::new(ways.controller(scale), &plan);
    let cycle = ways.cycle(model, &guard, paths.into()).expect("fits");
    cycle.with_readers(vec![reader]).expect("room")
}

/// Runs 3000 cycles with a request in one of them. How often the ways changed, the state at the end, and the word of X (µm)
/// in some cycles.
fn run(disarm_at: u32, look_at: [u32; 3]) -> (u32, State, [f64; 3]) {
    let ways = Ways::to(Control::default(), Clock::manual());
    let mut cycle = cycle(&ways);
    let (mut changes, mut active, mut words) = (0, 0, [f64::NAN; 3]);
    for n in 0..3000 {
        let mut told = ways.plant();
        told.is_scale_silent = n >= SILENT_AT;
        let word_um = told.word[0] * 1e3;
        drop(told);
        let request = match n {
            5 => Some(Request::Arm),
            _ if n == disarm_at => Some(Request::Disarm),
            _ => None,
        };
        let report = ways.step(&mut cycle, request);
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
    let ways = Ways::to(Control::default(), Clock::system());
    let mut cycle = cycle(&ways);
    cycle.attend_standbys().expect("threads");
    let mut longest = Duration::ZERO;
    for n in 0..400 {
        std::thread::sleep(PERIOD);
        let mut told = ways.plant();
        (told.is_scale_silent, told.hangs) = (n >= 250, Duration::from_secs(2));
        drop(told);
        let request = match n {
            5 => Some(Request::Arm),
            260 => Some(Request::Disarm),
            _ => None,
        };
        let begun = Instant::now();
        let report = ways.run(&mut cycle, request);
        longest = longest.max(begun.elapsed());
        if n == 249 {
            assert!(report.state.is_armed(), "{report:?}");
        }
    }
    assert_eq!(cycle.report().state, State::Disarmed);
    let word = ways.plant().word[0];
    assert_eq!(word, 0.0);
    assert!(longest < Duration::from_millis(500), "{longest:?}");
}
