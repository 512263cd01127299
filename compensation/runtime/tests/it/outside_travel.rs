//! Implausible positions, and reversals that a cycle sees only in part.
//!
//! A position is implausible if it is too far outside the travel, or unreachable from the previous position. A reversal
//! is missed while the position of another axis is rejected or during a gap of readings.

use volcomp_model::Machine;
use volcomp_port::Clock;
use volcomp_runtime::{
    Cycle, Report,
    guard::{Hold, Reasons, Request, State},
};
use volcomp_vocabulary::AxisName;

use crate::{
    rig::{Injected, NAMES, Rig, alone, guard, machine, machine_file, without_barrier},
    ways::{AXES, Control, Ways, guard_um, three_axes},
};

/// Positions of Z (travel −500 to 0), B, X, C, Y.
const PLACE: [f64; 5] = [-100.0, 20.0, 300.0, 40.0, 200.0];

#[test]
fn a_position_far_outside_the_travel_holds_and_comes_back() {
    let control = Injected::default();
    let mut rig = Rig::injected(PLACE, &control);
    let armed = rig.arm(5000);
    assert_eq!(armed.state, State::Compensating, "{armed:?}");
    assert_eq!(armed.outside_travel, 0);
    let applied = armed.sent.unwrap();
    let z = machine().index_of(AxisName::Z).unwrap();
    assert!(applied[z] != 0.0);
    // Positions up to 5 mm beyond the travel are accepted, because limit switches are there.
    go(&mut rig, &control, [0.0, 104.9]);
    let report = rig.run(50);
    assert_eq!(report.state, State::Compensating);
    assert_eq!((report.outside_travel, report.jumped), (0, 0));
    go(&mut rig, &control, [104.9, 0.0]);
    let applied = rig.run(2000).sent.unwrap();
    for displaced in [105.1, 4000.0, -405.1] {
        control.displace(displaced);
        let report = rig.step(None);
        assert!(report.reasons.contains(Reasons::OUTSIDE_TRAVEL), "{report:?}");
        assert_eq!(report.outside_travel, 1 << z);
        assert_eq!(report.error, None);
        let held = rig.run(10);
        assert!((held.sent.unwrap()[z] - applied[z]).abs() < 1e-9, "{held:?}");
        let lost = rig.run(5000);
        assert_eq!(lost.state, State::Holding(Hold::Lost), "{lost:?}");
        assert_eq!(lost.sent.unwrap()[z], 0.0);
        control.displace(0.0);
        let report = rig.run(5000);
        assert_eq!(report.state, State::Compensating, "{report:?}");
        assert!(!report.reasons.contains(Reasons::OUTSIDE_TRAVEL));
        assert!((report.sent.unwrap()[z] - applied[z]).abs() < 1e-6, "{report:?}");
    }
}

/// Moves the first axis from one displacement to another, mm, at 90 m/min.
fn go(rig: &mut Rig, control: &Injected, [from, to]: [f64; 2]) {
    let mut at = from;
    while (at - to).abs() > f64::EPSILON {
        at += (to - at).clamp(-6.0, 6.0);
        control.displace(at);
        let report = rig.step(None);
        assert_eq!(report.jumped, 0, "{report:?}");
    }
}

fn compensating() -> (Rig, Injected, Report) {
    let control = Injected::default();
    let mut rig = Rig::injected(PLACE, &control);
    let armed = rig.arm(5000);
    assert_eq!(armed.state, State::Compensating, "{armed:?}");
    (rig, control, armed)
}

#[test]
fn a_jump_within_the_travel_holds_ramps_out_and_returns_with_the_position() {
    let (mut rig, control, armed) = compensating();
    let z = machine().index_of(AxisName::Z).unwrap();
    let applied = armed.sent.unwrap();
    assert!(applied[z] != 0.0);
    // Z jumps to −400 mm, and to −100/25.4 mm, as in another unit.
    for displaced in [-300.0, 100.0 - 100.0 / 25.4] {
        control.displace(displaced);
        let report = rig.step(None);
        assert!(report.reasons.contains(Reasons::JUMPED), "{report:?}");
        assert_eq!((report.jumped, report.outside_travel), (1 << z, 0));
        assert_eq!((report.error, report.sent), (None, armed.sent));
        let held = rig.run(10);
        assert!((held.sent.unwrap()[z] - applied[z]).abs() < 1e-9);
        // A wrong position is not accepted with time.
        let lost = rig.run(5000);
        assert_eq!(lost.state, State::Holding(Hold::Lost), "{lost:?}");
        assert_eq!((lost.sent.unwrap()[z], lost.jumped), (0.0, 1 << z));
        control.displace(0.0);
        let report = rig.run(5000);
        assert_eq!(report.state, State::Compensating, "{report:?}");
        assert_eq!(report.jumped, 0);
        assert!((report.sent.unwrap()[z] - applied[z]).abs() < 1e-6);
    }
    // Arming again accepts the current position.
    control.displace(-300.0);
    rig.run(100);
    rig.step(Some(Request::Disarm));
    rig.run(1000);
    rig.step(Some(Request::Arm));
    let report = rig.run(5000);
    assert_eq!(report.state, State::Compensating, "{report:?}");
    assert_eq!((report.positions[z], report.jumped), (-400.0, 0));
}

#[test]
fn a_new_travel_accepts_the_next_position() {
    let (mut rig, control, _) = compensating();
    let z = machine().index_of(AxisName::Z).unwrap();
    let text = machine_file();
    let narrow = text.replace("travel = [-500.0, 0.0]", "travel = [-150.0, 0.0]");
    let swap = |rig: &mut Rig, text: &str| {
        let machine = Machine::parse(text, "m.toml").expect("valid");
        rig.swap(&machine);
    };
    swap(&mut rig, &narrow);
    go(&mut rig, &control, [0.0, -300.0]);
    let report = rig.run(5000);
    assert_eq!(report.outside_travel, 1 << z, "{report:?}");
    swap(&mut rig, &text);
    let report = rig.run(5000);
    assert_eq!((report.outside_travel, report.jumped), (0, 0), "{report:?}");
    assert_eq!(report.state, State::Compensating, "{report:?}");
}

/// Z is reported 200 mm too low, within its travel or beyond it; another travel in the machine file does not make the wrong position valid.
#[test]
fn a_new_travel_accepts_no_jumped_position() {
    for displaced in [-200.0, -600.0] {
        let (mut rig, control, _) = compensating();
        let z = machine().index_of(AxisName::Z).unwrap();
        control.displace(displaced);
        rig.run(5);
        let text = machine_file().replace("travel = [-500.0, 0.0]", "travel = [-800.0, 0.5]");
        rig.swap(&Machine::parse(&text, "m.toml").expect("valid"));
        let report = rig.run(5000);
        assert_eq!(report.jumped, 1 << z, "{report:?}");
        assert_eq!(report.state, State::Holding(Hold::Lost), "{report:?}");
        control.displace(0.0);
        let report = rig.run(5000);
        assert_eq!(report.state, State::Compensating, "{report:?}");
        assert_eq!(report.positions[z], -100.0, "{report:?}");
    }
}

#[test]
fn motion_at_rapid_after_a_silence_is_accepted() {
    let (mut rig, control, _) = compensating();
    control.set_silent(true);
    rig.run(50);
    control.set_silent(false);
    // The position after 200 ms at 90 m/min, as if the axis had continued.
    control.displace(-300.0);
    assert_eq!(rig.step(None).jumped, 0);
    go(&mut rig, &control, [-300.0, 0.0]);
    assert_eq!(rig.run(1000).state, State::Compensating);
}

/// A table that counts on or restarts at 0 after a turn is accepted; half a turn at once is a jump.
#[test]
fn a_table_that_rolls_over_is_accepted() {
    let mut names = NAMES;
    names.sort_by_key(|name| *name != AxisName::C);
    let control = Injected::default();
    let mut rig = Rig::injected_of(&names, &[40.0, -100.0, 20.0, 300.0, 200.0], &control);
    assert_eq!(rig.arm(5000).state, State::Compensating);
    for turns in [-1.0, 0.0, 1.0, 0.0, 12.0, 0.5] {
        control.displace(turns * core::f64::consts::TAU);
        let report = rig.run(20);
        let jumps = turns == 0.5;
        assert_eq!(report.jumped != 0, jumps, "{turns} turns: {report:?}");
        assert_eq!(report.outside_travel, 0);
    }
}

/// After referencing, a jump is accepted only by arming again. Stale flags also read "not referenced", but must not confirm a jump.
#[test]
fn a_position_after_referencing_is_accepted_after_arming_again() {
    let (mut rig, control, armed) = compensating();
    control.set_unreferenced(true);
    control.displace(-300.0);
    rig.run(10);
    control.set_unreferenced(false);
    let report = rig.run(2000);
    assert_eq!(report.state, State::Holding(Hold::Lost), "{report:?}");
    assert_ne!(report.jumped, 0);
    rig.step(Some(Request::Disarm));
    rig.run(1000);
    rig.step(Some(Request::Arm));
    let report = rig.run(5000);
    assert_eq!(report.state, State::Compensating, "{report:?}");
    assert_eq!((report.jumped, armed.jumped), (0, 0));
}

/// A rotary axis whose travel is a turn is never outside, even if a thousandth of a degree is missing in the turn.
#[test]
fn a_table_with_a_turn_of_travel_is_nowhere_outside() {
    for (travel, at, is_outside) in [
        ("[0.0, 359.999]", 366.0, false),
        ("[0.0, 360.0]", -4000.0, false),
        ("[0.0, 350.0]", 354.9, false),
        ("[0.0, 350.0]", 355.1, true),
    ] {
        let text = machine_file()
            .replace("travel = [0.0, 360.0]", &format!("travel = {travel}"))
            .replace("modulo = 360.0\n", "");
        let machine = Machine::parse(&text, "five-axis.toml").expect("valid");
        let place = [-100.0, 20.0, 300.0, at, 200.0];
        let report = Rig::of(&machine, &guard(), place, &NAMES).run(20);
        let c = machine.index_of(AxisName::C).unwrap();
        let expected = u16::from(is_outside) << c;
        assert_eq!(report.outside_travel, expected, "{travel} at {at}");
    }
}

#[test]
fn a_modulo_axis_is_nowhere_outside() {
    let place = [-100.0, 20.0, 300.0, 36_040.0, 200.0];
    let report = Rig::at(place).run(20);
    assert_eq!(report.outside_travel, 0, "{report:?}");
    assert!(!report.reasons.contains(Reasons::OUTSIDE_TRAVEL));
    assert!(report.error.is_some());
    // At an implausible position the gateway does not arm.
    let mut rig = Rig::at([-100.0, 116.0, 300.0, 40.0, 200.0]);
    let report = rig.arm(5000);
    assert_eq!(report.state, State::Disarmed, "{report:?}");
    assert!(report.reasons.contains(Reasons::OUTSIDE_TRAVEL));
}

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
