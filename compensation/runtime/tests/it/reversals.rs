//! Reversals that a cycle sees only in part: while the position of another axis is rejected, and during a gap of readings.

use volcomp_port::Clock;
use volcomp_runtime::{
    Cycle, Report,
    guard::{Request, State},
};
use volcomp_vocabulary::AxisName;

use crate::{
    rig::{alone, without_barrier},
    ways::{AXES, Control, Ways, guard_um, three_axes},
};

/// EYY is 10 µm after motion in the positive direction, −10 µm after motion in the negative one, and 0 while the direction is unknown.
const REVERSAL: &str = "EYY = { mean = { poly = [0.0] }, reversal = 20.0 }";
const CONTROL: &str = "control";

/// Reason why the cycle does not see the motion.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Blind {
    Nothing,
    /// The position of X is rejected for these cycles.
    Jump(u32),
    /// The positions of X and Y are rejected for these cycles.
    JumpOfBoth(u32),
    /// The control does not answer for these cycles.
    Silence(u32),
}

struct Scene {
    ways: Ways<Control>,
    cycle: Cycle,
}

impl Scene {
    fn compensating() -> Self {
        let ways = Ways::to(Control::default(), Clock::manual());
        let guard = guard_um(30.0);
        let model = three_axes(REVERSAL, &guard);
        let path = ways.path(without_barrier(CONTROL, &AXES), &model, &guard, &alone());
        let cycle = ways.cycle(model, &guard, vec![path]).expect("one path");
        let mut scene = Self { ways, cycle };
        for number in 0..500 {
            scene.step((number == 50).then_some(Request::Arm));
        }
        assert_eq!(scene.run(1).state, State::Compensating);
        scene
    }

    fn step(&mut self, request: Option<Request>) -> Report {
        self.ways.step(&mut self.cycle, request)
    }

    fn run(&mut self, cycles: u32) -> Report {
        (1..cycles).for_each(|_| {
            self.step(None);
        });
        self.step(None)
    }

    fn shift(&self, axis: AxisName, by: f64) {
        *self.ways.plant().place.entry(axis).or_default() += by;
    }

    /// Moves Y by `by` mm in ten cycles.
    fn go(&mut self, by: f64) {
        for _ in 0..10 {
            self.shift(AxisName::Y, 0.1 * by);
            self.step(None);
        }
    }
}

/// Y moves forwards, then back unseen by the cycle. Returns its correction afterwards, µm.
fn corrected_um(blind: Blind) -> f64 {
    let mut scene = Scene::compensating();
    scene.go(100.0);
    let report = scene.run(100);
    let y = report.wanted[1] * 1e3;
    assert!((y + 10.0).abs() < 1e-9, "{blind:?}: {y}");
    let wrong = |scene: &Scene, by: f64| {
        if matches!(blind, Blind::Jump(_) | Blind::JumpOfBoth(_)) {
            scene.shift(AxisName::X, by);
        }
        if matches!(blind, Blind::JumpOfBoth(_)) {
            scene.shift(AxisName::Y, 3.0 * by);
        }
        let is_silent = matches!(blind, Blind::Silence(_)) && by > 0.0;
        scene.ways.plant().away = is_silent.then_some(CONTROL);
    };
    wrong(&scene, 95.0);
    scene.go(-50.0);
    let (Blind::Jump(cycles) | Blind::JumpOfBoth(cycles) | Blind::Silence(cycles)) = blind else {
        return scene.run(1000).wanted[1] * 1e3;
    };
    let report = scene.run(cycles);
    let is_rejected = report.jumped != 0;
    assert_eq!(is_rejected, !matches!(blind, Blind::Silence(_)), "{report:?}");
    wrong(&scene, -95.0);
    let report = scene.run(1000);
    assert_eq!(report.state, State::Compensating, "{blind:?}: {report:?}");
    report.wanted[1] * 1e3
}

#[test]
fn the_direction_of_an_axis_is_followed_while_another_is_rejected() {
    assert_eq!(corrected_um(Blind::Nothing).round(), 10.0);
    for cycles in [20, 200, 2000] {
        assert_eq!(corrected_um(Blind::Jump(cycles)).round(), 10.0, "{cycles}");
    }
}

/// Readings are missing for longer than positions may be held: the axis may have reversed, and gets the mean of both directions.
#[test]
fn the_direction_of_an_axis_is_unknown_after_a_gap() {
    for cycles in [200, 2000] {
        for blind in [Blind::JumpOfBoth(cycles), Blind::Silence(cycles)] {
            assert_eq!(corrected_um(blind), 0.0, "{blind:?}");
        }
    }
}
