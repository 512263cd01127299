//! What the run before may have left on a path that does not answer.

use std::time::Duration;

use volcomp_port::{Clock, Description, Fault, Snapshot};
use volcomp_runtime::{
    Asked, AxisSettings, Cycle, GuardSettings, PathSettings,
    guard::{Reasons, Request, State},
};
use volcomp_vocabulary::{PerAxis, PerChannel, Um};

use crate::{
    rig::{PERIOD, referenced, without_barrier},
    ways::{AXES, Plant, Ways, three_axes},
};

/// A control that words lead to, which can be read back, and lines.
#[derive(Default)]
struct Control {
    /// The words do not answer.
    silent: bool,
    /// The correction of X that is written by the words, and by the lines, mm.
    x: [f64; 2],
    /// Both lead to one and the same word.
    is_one: bool,
    /// The largest change of X by one write, mm.
    largest: f64,
}

impl Control {
    fn x(&mut self, way: &Description) -> &mut f64 {
        let is_lines = !way.tells_applied && !self.is_one;
        &mut self.x[usize::from(is_lines)]
    }

    /// The corrections, µm.
    fn x_um(&self) -> [f64; 2] {
        self.x.map(|x| (x * 1e3).round())
    }
}

impl Plant for Control {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        if self.silent && way.tells_applied {
            return Err(Fault::NotConnected);
        }
        let applied = PerChannel::leading([*self.x(way)]);
        let told = way.tells_applied.then_some(applied);
        Ok(referenced(PerChannel::ZERO, clock.now(), told))
    }

    fn apply(
        &mut self,
        way: &Description,
        corrections: &PerChannel<f64>,
        _: &Clock,
    ) -> Result<(), Fault> {
        let x = self.x(way);
        let change = (corrections[0] - *x).abs();
        *x = corrections[0];
        self.largest = self.largest.max(change);
        Ok(())
    }
}

/// Words that can be read back, and lines.
fn two_ways(ways: &Ways<Control>) -> Cycle {
    let guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    let model = three_axes("EXX = { poly = [-25, 0.5] }", &guard);
    let paths = [("words", true), ("lines", false)].map(|(name, tells_applied)| {
        let description = Description {
            tells_applied,
            ..without_barrier(name, &AXES)
        };
        ways.path(description, &model, &guard, &PathSettings::default())
    });
    ways.cycle(model, &guard, paths.into()).expect("fits")
}

/// Words that do not answer, and lines, with -25 µm on X. `remembered`: what was written down of X, mm. Gives the state, its
/// reasons, and the largest change of X by one write, mm.
fn run(remembered: Option<f64>, acknowledged: bool) -> (State, Reasons, f64) {
    let x = if remembered == Some(0.0) || acknowledged {
        0.0
    } else {
        -0.025
    };
    let control = Control {
        silent: true,
        x: [x; 2],
        is_one: true,
        largest: 0.0,
    };
    let ways = Ways::to(control, Clock::manual());
    let mut cycle = two_ways(&ways);
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
        ways.step(&mut cycle, request);
    }
    let report = cycle.report();
    (report.state, report.reasons, ways.plant().largest)
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
    let control = Control {
        silent: true,
        ..Control::default()
    };
    let ways = Ways::to(control, Clock::manual());
    let mut cycle = two_ways(&ways);
    cycle.restore(&PerAxis::ZERO, Duration::from_secs(1));
    for n in 0..500 {
        ways.step(&mut cycle, (n == 100).then_some(Request::Arm));
    }
    assert_eq!(ways.plant().x_um(), [0.0, 25.0]);
    ways.plant().silent = false;
    for _ in 0..2500 {
        ways.step(&mut cycle, None);
    }
    assert_eq!(cycle.report().active, 0, "{:?}", cycle.report().reasons);
    assert_eq!(ways.plant().x_um(), [25.0, 25.0]);
    let holds = |cycle: &Cycle| cycle.report().reasons.contains(Reasons::STANDBY_HOLDS);
    assert!(holds(&cycle));
    for n in 0..500 {
        ways.step(&mut cycle, (n == 0).then_some(Request::Disarm));
    }
    assert_eq!(cycle.report().state, State::Disarmed);
    assert_eq!(ways.plant().x_um(), [0.0, 25.0]);
    assert!(holds(&cycle));
}

/// The silent first way had -25 µm, which were written down. A person acknowledged the fault of before the restart, and with
/// it, unasked, that nothing was left there: X went from -25 to 0 µm in one write.
#[test]
fn who_acknowledges_a_fault_says_nothing_of_what_is_left_elsewhere() {
    let control = Control {
        silent: true,
        x: [-0.025; 2],
        is_one: true,
        largest: 0.0,
    };
    let ways = Ways::to(control, Clock::manual());
    let mut cycle = two_ways(&ways);
    let left = PerAxis::from_fn(|axis| if axis == 0 { -0.025 } else { 0.0 });
    cycle.restore(&left, Duration::from_secs(1));
    for number in 0..500 {
        ways.clock.advance(PERIOD);
        let asked = Asked {
            request: match number {
                50 => Some(Request::Acknowledge),
                100 => Some(Request::Arm),
                _ => None,
            },
            forbids: Reasons::FAULTED_BEFORE.when(number <= 50),
            ..Asked::default()
        };
        cycle.run(ways.clock.now(), &asked, &mut || Duration::ZERO);
    }
    let largest_change = ways.plant().largest;
    assert!(largest_change <= 0.002 + 1e-9, "{largest_change} mm");
}
