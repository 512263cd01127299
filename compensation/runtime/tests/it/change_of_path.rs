//! Two ways without a barrier to one control, and the axis when the way changes.

use std::time::Duration;

use volcomp_port::{Clock, Description, Fault, Snapshot};
use volcomp_runtime::{
    AxisSettings, GuardSettings, PathPlan,
    guard::{Request, State},
};
use volcomp_vocabulary::{PerChannel, Um};

use crate::{
    rig::{PERIOD, alone, referenced, without_barrier},
    ways::{AXES, Plant, Ways, three_axes},
};

/// The error of X changes by 0.5 µm in 1 mm.
const ERRORS: &str = "EXX = { poly = [-25, 0.5] }";

/// The control: where X is (mm), its words in the order of `AXES`, and whether the first way answers.
#[derive(Default)]
struct Control {
    x: f64,
    words: PerChannel<f64>,
    first_is_away: bool,
    /// The largest change of a word by one write, mm.
    largest: f64,
}

impl Control {
    fn answers(&self, way: &Description) -> Result<(), Fault> {
        if way.device == "first" && self.first_is_away {
            return Err(Fault::TimedOut);
        }
        Ok(())
    }
}

impl Plant for Control {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        self.answers(way)?;
        let axes = PerChannel::leading([self.x]);
        let [positions, words] = [axes, self.words].map(|values| {
            let mut of_way = PerChannel::ZERO;
            for (value, place) in of_way.iter_mut().zip(places(way)) {
                *value = values[place];
            }
            of_way
        });
        Ok(referenced(positions, clock.now(), Some(words)))
    }

    fn apply(
        &mut self,
        way: &Description,
        corrections: &PerChannel<f64>,
        _: &Clock,
    ) -> Result<(), Fault> {
        self.answers(way)?;
        for (correction, place) in corrections.iter().zip(places(way)) {
            let change = (correction - self.words[place]).abs();
            self.largest = self.largest.max(change);
            self.words[place] = *correction;
        }
        Ok(())
    }
}

/// The place in `AXES` of each axis of a way.
fn places(way: &Description) -> impl Iterator<Item = usize> + '_ {
    let place = |name| AXES.iter().position(|axis| *axis == name);
    way.axes.iter().filter_map(move |axis| place(axis.name))
}

/// X stands, travels 100 mm with 60 m/min from the cycle `begins` on, and stands. The first way is away for a second from
/// cycle 800 + `offset` on. The largest change of the axis by one write, µm.
fn largest_write_um(offset: u64, begins: u64, hand_back: Duration) -> f64 {
    let ways = Ways::to(Control::default(), Clock::manual());
    let mut guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    guard.hand_back = hand_back;
    let model = three_axes(ERRORS, &guard);
    let paths = ["first", "second"].map(|device| {
        let description = without_barrier(device, &AXES);
        ways.path(description, &model, &guard, &alone())
    });
    let mut cycle = ways.cycle(model, &guard, paths.into()).expect("two paths");
    let mut seen = [false; 2];
    for number in 0..2500 {
        {
            let mut plant = ways.plant();
            let travels = (begins..begins + 25).contains(&number);
            plant.x += if travels { 4.0 } else { 0.0 };
            plant.first_is_away = (800 + offset..1050 + offset).contains(&number);
        }
        let request = (number == 5).then_some(Request::Arm);
        let report = ways.step(&mut cycle, request);
        seen[report.active] |= report.state == State::Compensating;
    }
    assert_eq!(seen, [true; 2], "both correct in their turn");
    ways.plant().largest * 1e3
}

/// Before, the first write over the other way was made from what it had said when it stood by, up to 100 ms before: the axis
/// went back by 26 µm in one cycle where 2 µm are allowed.
#[test]
fn a_change_of_ways_in_motion_makes_no_step() {
    let (sooner, later) = (Duration::from_secs(2), Duration::from_millis(2050));
    for offset in (0..30).step_by(3) {
        for (begins, hand_back) in [
            (800, sooner),
            (805, sooner),
            (810, sooner),
            (1550, later),
            (1560, later),
            (1570, later),
        ] {
            let largest = largest_write_um(offset, begins, hand_back);
            assert!(
                largest <= 2.0 + 1e-6,
                "away at 800 + {offset}, travels at {begins}: {largest} µm"
            );
        }
    }
}

/// The second way has its axes in another order, and lower limits: what the first one has sent comes in by a ramp. It was a
/// correction beyond the limit that nobody had sent: a fault, and the correction stayed in the words.
#[test]
fn a_way_with_lower_limits_leads_in_what_the_way_before_has_sent() {
    let ways = Ways::to(Control::default(), Clock::manual());
    let mut guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    let model = three_axes(ERRORS, &guard);
    let mut turned = AXES;
    turned.reverse();
    let descriptions = [
        without_barrier("first", &AXES),
        without_barrier("second", &turned),
    ];
    let second = descriptions[1].clone();
    let plan = PathPlan::new(second, &model, &guard, &alone(), PERIOD).expect("fits");
    let mut lower = plan.limits;
    for axis in lower.axes.iter_mut().take(lower.count) {
        (axis.limit, axis.warn) = (0.010, 0.010);
    }
    let paths = descriptions.map(|of_way| ways.path(of_way, &model, &guard, &alone()));
    let mut cycle = ways.cycle(model, &guard, paths.into()).expect("two paths");
    cycle.set_limits(1, &lower).expect("lower");
    for number in 0..1300 {
        ways.plant().first_is_away = number >= 800;
        let request = (number == 5).then_some(Request::Arm);
        let report = ways.step(&mut cycle, request);
        if number == 799 {
            assert_eq!((report.active, report.state), (0, State::Compensating));
            assert!((ways.plant().words[0].abs() - 0.025).abs() < 1e-9);
        }
    }
    let report = cycle.report();
    assert_eq!((report.active, report.state), (1, State::Compensating));
    let plant = ways.plant();
    assert!((plant.words[0].abs() - 0.010).abs() < 1e-9);
    assert!(plant.largest <= 0.002 + 1e-9, "{} mm", plant.largest);
}
