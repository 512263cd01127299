//! Axes that do not correct, and axes that are only read.
//!
//! An axis that the machine file excludes, or whose correction would increase the tool error, gets zero only. Linear
//! axes that a rotary axis turns parallel are reported. The correction of the other axes is that for the current
//! positions of the axes that are only read.

use std::time::Duration;

use volcomp_model::{Fading, Machine};
use volcomp_port::{Axis, Clock, Controller, Description, simulated::Move};
use volcomp_runtime::{
    AxisSettings, BarrierSettings, Cycle, GuardSettings, Model, PathPlan, PathSettings, PlanError,
    PositionReader, ReaderPlan, Report, UncorrectedReason, WithoutBarrier,
    guard::{Reasons, Request, State},
};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, PerAxis, PerChannel, Um, Urad};

use crate::rig::{
    Injected, NAMES, PERIOD, Rig, Writes, alone, control, cycle_of, guard, machine, machine_file,
    path_of, simulated_control, step, tip_mm,
};

const PLACE: [f64; 5] = [-100.0, 40.0, 200.0, 50.0, 300.0];

/// The five-axis machine of the examples with only these correcting axes.
fn correcting(names: &str) -> Machine {
    let text = format!("correct = [{names}]\n{}", machine_file());
    Machine::parse(&text, "held").expect("valid")
}

fn shifting() -> GuardSettings {
    let mut guard = guard();
    guard.linear.test_shift = Um(5.0);
    guard.rotary = Some(AxisSettings {
        test_shift: Urad(20.0),
        ..AxisSettings::new(Urad(250.0), Urad(500.0))
    });
    guard
}

/// Arms, and returns the largest output of each machine axis in 3000 cycles.
fn largest_outputs(rig: &mut Rig, machine: &Machine) -> Vec<(AxisName, f64)> {
    let joints = machine.chain().joints();
    let mut largest: Vec<_> = joints.iter().map(|joint| (joint.name, 0.0_f64)).collect();
    rig.run(10);
    rig.step(Some(Request::Arm));
    for _ in 0..3000 {
        let report = rig.step(None);
        for ((_, largest), output) in largest.iter_mut().zip(&report.correction.0) {
            *largest = largest.max(output.abs());
        }
    }
    assert_eq!(rig.step(None).state.name(), "compensating");
    largest
}

#[test]
fn nothing_is_written_to_axes_that_do_not_correct() {
    let machine = correcting("\"X\", \"Y\", \"Z\"");
    for guard in [shifting(), GuardSettings { rotary: None, ..shifting() }] {
        let mut rig = Rig::of(&machine, &guard, PLACE, &NAMES);
        for (name, largest) in largest_outputs(&mut rig, &machine) {
            if name.is_rotary() {
                assert_eq!(largest, 0.0, "axis {name} may not correct");
            } else {
                assert!(largest > 0.0049, "axis {name} corrects: {largest} mm");
            }
        }
    }
}

#[test]
fn a_redundant_linear_axis_is_not_shifted() {
    let text = "structure = \"w b X Y Z C t\"
[axes.X]
travel = [0.0, 500.0]
[axes.Y]
travel = [-500.0, 500.0]
direction = [1.0, 0.0, 0.0]
[axes.Z]
travel = [-500.0, 500.0]
[axes.C]
travel = [-360.0, 360.0]
[errors]
EXX = { poly = [0.0, 0.02] }
";
    let machine = Machine::parse(text, "redundant").expect("valid");
    let names = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::C];
    let mut rig = Rig::of(&machine, &shifting(), PLACE, &names);
    let outputs = largest_outputs(&mut rig, &machine);
    let of = |name| outputs.iter().find(|(axis, _)| *axis == name).map(|o| o.1);
    assert_eq!(of(AxisName::Y), Some(0.0), "Y lies along X");
    assert!(of(AxisName::X) > Some(0.0049) && of(AxisName::Z) > Some(0.0049));
}

#[test]
fn another_model_removes_the_test_shift_of_axes_that_no_longer_correct() {
    let before = machine();
    let mut rig = Rig::of(&before, &shifting(), PLACE, &NAMES);
    let after = correcting("\"X\", \"Y\", \"Z\"");
    rig.swap(&after);
    for (name, largest) in largest_outputs(&mut rig, &after) {
        assert_eq!(largest > 0.0, !name.is_rotary(), "axis {name}: {largest}");
    }
    // Limits planned for the old model do not restore the test shift of the axis.
    let mut rig = Rig::of(&before, &shifting(), PLACE, &NAMES);
    let limits = rig.limits;
    rig.swap(&after);
    rig.cycle.set_limits(0, &limits).expect("as before");
    for (name, largest) in largest_outputs(&mut rig, &after) {
        assert_eq!(largest > 0.0, !name.is_rotary(), "axis {name}: {largest}");
    }
}

#[test]
fn axes_without_a_test_shift_are_reported_as_not_proven() {
    let rotary = shifting();
    let mut linear = shifting();
    if let Some(rotary) = &mut linear.rotary {
        rotary.test_shift = Urad(0.0);
    }
    for (guard, reported) in [(rotary, false), (linear, true)] {
        let mut rig = Rig::of(&machine(), &guard, PLACE, &NAMES);
        let report = rig.run(5);
        let reasons = report.reasons;
        assert_eq!(reasons.contains(Reasons::NOT_PROVEN), reported, "{reasons:?}");
    }
}

/// The plan for a control of the five-axis machine with these axes and this step (µrad).
fn plan(axes: &[AxisName], step_urad: f64, most: Um) -> Result<PathPlan, PlanError> {
    let mut description: Description = control([0.0; 5], &Clock::manual()).description().clone();
    let of = |name: &AxisName| Axis {
        name: *name,
        includes_correction: false,
        resolution: Displacement::from_micro(
            name.kind(),
            if name.is_rotary() { step_urad } else { 1.0 },
        ),
        largest: None,
    };
    let machine = machine();
    description.axes = axes.iter().map(of).collect();
    let others = NAMES.iter().filter(|name| !axes.contains(name));
    description.reads = others.copied().collect();
    let mut guard = guard();
    guard.rotary_step = most;
    let model = Model::new(&machine, guard.fading).expect("compiles");
    PathPlan::new(description, &model, &guard, &alone(), PERIOD)
}

/// Plan for all axes with this step and these limits of the rotary axes.
fn shipped(
    step_deg: f64,
    has_barrier: bool,
    rotary: Option<AxisSettings<Urad>>,
) -> Result<PathPlan, PlanError> {
    let mut description: Description = control([0.0; 5], &Clock::manual()).description().clone();
    for axis in description.axes.iter_mut().filter(|axis| axis.name.is_rotary()) {
        axis.resolution = Displacement::from_micro(AxisKind::Rotary, step_deg.to_radians() * 1e6);
    }
    description.barrier = has_barrier;
    let mut guard = guard();
    (guard.rotary, guard.without_barrier) = (rotary, WithoutBarrier::default());
    let mut settings = alone();
    settings.barrier =
        has_barrier.then_some(BarrierSettings { machine: 1, scan: Duration::from_millis(2) });
    let model = Model::new(&machine(), guard.fading).expect("compiles");
    PathPlan::new(description, &model, &guard, &settings, PERIOD)
}

/// An axis whose step exceeds its limit is held at zero, with and without configured limits.
#[test]
fn axes_that_are_too_coarse_to_correct_need_no_limits() {
    let stated = AxisSettings::new(Urad(250.0), Urad(500.0));
    for step_deg in [0.01, 0.2] {
        for has_barrier in [true, false] {
            for rotary in [Some(stated), None] {
                let case = format!("{step_deg} deg, barrier {has_barrier}, {rotary:?}");
                let plan = shipped(step_deg, has_barrier, rotary)
                    .unwrap_or_else(|error| panic!("{case}: {error}"));
                let uncorrected = plan.uncorrected.iter().map(|out| out.axis);
                let uncorrected: Vec<_> = uncorrected.collect();
                assert_eq!(uncorrected, [AxisName::C, AxisName::B], "{case}");
                for axis in plan.limits.axes.iter().take(plan.limits.count) {
                    let is_rotary = axis.kind == AxisKind::Rotary;
                    assert_eq!(axis.reachable() == 0.0 && is_rotary, axis.limit == 0.0);
                    assert!(is_rotary || axis.limit > 0.0, "{case}");
                }
            }
        }
    }
    // A correcting axis whose limit is below its step is rejected.
    let fine = AxisSettings::new(Urad(0.5), Urad(500.0));
    let refused = shipped(0.0001, true, Some(fine)).expect_err("less than a step");
    assert!(refused.to_string().contains("expected at least one step"), "{refused}");
}

/// A rotary axis corrects only if half its step times its lever is within the permitted error.
#[test]
fn a_rotary_axis_with_coarse_steps_is_not_corrected() {
    let model = Model::new(&machine(), Fading::default()).expect("compiles");
    let error = |name: AxisName, urad: f64| {
        let axis = model.index_of(name).expect("an axis");
        let step = volcomp_vocabulary::Urad(urad).to_rad();
        model.rotary_step_error(axis, step).to_um()
    };
    let [b, c] = [AxisName::B, AxisName::C].map(|name| error(name, 20.0));
    assert!(b < c && b > Um(1.0), "levers of B and C: {b} {c}");
    let corrects = |most: f64| {
        let plan = plan(&NAMES, 20.0, Um(most)).expect("fits");
        let uncorrected = plan.uncorrected.iter().map(|out| (out.axis, out.why));
        (plan.correctors.rotary().len(), uncorrected.collect::<Vec<_>>())
    };
    assert_eq!(corrects(c.0 * 1.001), (2, Vec::new()));
    let (count, uncorrected) = corrects(c.0 * 0.999);
    assert_eq!(count, 1);
    let [(AxisName::C, UncorrectedReason::Coarse(error))] = uncorrected[..] else {
        panic!("{uncorrected:?}")
    };
    assert!((error.to_um() - c).0.abs() < 1e-9);
    assert_eq!(corrects(b.0 * 0.999).0, 0);
}

/// Rotary axes correct only with three linear directions, which compensate the motion of the tip. A controller without correcting axes is
/// rejected.
#[test]
fn rotary_axes_correct_only_with_three_linear_directions() {
    let [x, y, b, c] = [AxisName::X, AxisName::Y, AxisName::B, AxisName::C];
    let plan = |axes: &[AxisName]| plan(axes, 1.0, Um(1000.0));
    let two = plan(&[x, b, y]).expect("X and Y correct");
    assert!(two.correctors.rotary().is_empty());
    assert_eq!(two.uncorrected.len(), 1);
    assert_eq!(
        (two.uncorrected[0].axis, two.uncorrected[0].why),
        (b, UncorrectedReason::Uncatchable)
    );
    let refused = plan(&[b, c]).expect_err("nothing corrects");
    assert!(refused.to_string().contains("three linear directions"), "{refused}");
}

/// With X, Y and A only, A is not corrected, because no axis compensates its motion of the tip along Z; the tool error does not grow.
#[test]
fn a_machine_with_two_linear_directions_and_a_rotary_axis_gains_no_error() {
    let text = "structure = \"w A' b X Y t\"
axes.X = { travel = [-500.0, 500.0] }
axes.Y = { travel = [-500.0, 500.0] }
axes.A = { travel = [-90.0, 90.0], point = [0.0, 0.0, -300.0] }
errors = { EXX = 12.0, EYY = 8.0, EAA = 150.0, EAX = 100.0 }
";
    let machine = Machine::parse(text, "m").expect("valid");
    let names = [AxisName::X, AxisName::Y, AxisName::A];
    let mut rig = Rig::with(&machine, &guard(), &names, &[120.0, -80.0, 25.0]);
    let (report, worst) = rig.arm_and_compare(1500);
    let [x, y, a] = names.map(|name| machine.index_of(name).expect("an axis"));
    assert_eq!(report.correction[a], 0.0);
    assert!(report.correction[x].abs() > 1e-3 && report.correction[y].abs() > 1e-3);
    assert!(worst < 1e-6, "{worst} mm worse");
}

/// X is under a rotary table and Y on the tool side, so they are parallel at C = 90°: corrections that grow without bound there are
/// limited together and reported.
#[test]
fn linear_axes_turned_into_one_direction_are_reported() {
    let text = "structure = \"w X' C' b Y Z t\"
axes.X = { travel = [-500.0, 500.0] }
axes.Y = { travel = [-500.0, 500.0] }
axes.Z = { travel = [-500.0, 500.0] }
axes.C = { travel = [-180.0, 180.0] }
errors = { EXX = 10.0, EYY = 6.0, EXZ = 8.0, EYZ = -7.0 }
";
    let machine = Machine::parse(text, "m").expect("valid");
    let model = Model::new(&machine, Fading::default()).expect("compiles");
    let pose = model.linear_near_singular(&model.correctors_among(&model.axes));
    let c = machine.index_of(AxisName::C).expect("an axis");
    let at = pose.expect("C = ±90°")[c].abs().to_degrees();
    assert!((at - 90.0).abs() < 10.0, "{at}");
    // If no rotary axis turns linear axes relative to each other, there is no such pose.
    let five = Model::new(&crate::rig::machine(), Fading::default()).expect("compiles");
    assert_eq!(five.linear_near_singular(&five.correctors_among(&five.axes)), None);
    let names = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::C];
    for (c_deg, reported) in [(0.0, false), (80.0, false), (85.0, true), (89.9, true), (91.0, true)]
    {
        let mut rig = Rig::with(&machine, &guard(), &names, &[20.0, 30.0, 40.0, c_deg]);
        let (report, worst) = rig.arm_and_compare(1000);
        assert_eq!(report.reasons.contains(Reasons::LINEAR_NEAR_SINGULAR), reported, "C {c_deg}");
        assert!(worst < 1e-6, "C {c_deg}: {worst} mm worse");
        for (output, name) in report.correction.iter().zip(&model.axes) {
            assert!(output.abs() <= 0.25 + 1e-6, "{name}: {output}");
        }
    }
}

/// With a tool 1 mm longer, half a step of B exceeds the permitted error and B stops correcting: the reported move includes the removal
/// of its correction.
#[test]
fn a_rotary_axis_that_stops_correcting_counts_as_a_move() {
    let machine = |length: f64| {
        let text = format!(
            "structure = \"w C' X' b Y Z B t\"\n[axes.X]\ntravel = [0.0, 800.0]\n[axes.Y]\ntravel = [0.0, 600.0]\n[axes.Z]\ntravel = [-500.0, 0.0]\npoint = [400.0, 300.0, -120.0]\n[axes.B]\ntravel = [-110.0, 110.0]\npoint = [400.0, 300.0, 120.0]\n[axes.C]\ntravel = [0.0, 360.0]\npoint = [400.0, 300.0, 0.0]\nmodulo = 360.0\n[tool]\ngauge = [400.0, 300.0, 0.0]\nlength = {length:?}\n[errors]\nEBZ = -160.0\n"
        );
        Machine::parse(&text, "m").expect("valid")
    };
    let (old, changed) = (machine(120.0), machine(121.0));
    let mut settings = guard();
    settings.rotary = Some(AxisSettings::new(Urad(250.0), Urad(500.0)));
    // Half a step of the simulated control (1e-8 rad) at a lever of 240.5 mm.
    settings.rotary_step = Um(0.5 * 1e-8 * 240.5 * 1e3);
    let place = [-100.0, 0.0, 200.0, 50.0, 300.0];
    let mut rig = Rig::of(&old, &settings, place, &NAMES);
    let before = rig.arm(2000);
    let [old, new] = [&old, &changed].map(|m| Model::new(m, Fading::default()).expect("compiles"));
    let controller = control(place, &Clock::manual()).description().clone();
    let most = settings.rotary_step.to_mm();
    let way = [&old, &new].map(|model| model.correctors_of(&controller, most));
    let reported = old.largest_move(&new, [way]);
    rig.swap(&changed);
    rig.step(Some(Request::Switched));
    let after = rig.run(3000);
    let moved = |name: AxisName| {
        let axis = old.index_of(name).expect("an axis");
        (after.correction[axis] - before.correction[axis]).abs()
    };
    let linear = [AxisName::X, AxisName::Y, AxisName::Z].map(moved);
    let linear = linear.into_iter().fold(0.0, f64::max);
    let rotary = moved(AxisName::B).max(moved(AxisName::C));
    assert!(linear > 0.03 && rotary > 1e-4, "{linear} mm, {rotary} rad");
    assert!(reported.linear.0 > linear - 1e-3, "{} of {linear}", reported.linear);
    assert!(reported.rotary.0 > rotary - 1e-6, "{:?}", reported.rotary);
}

const WRITTEN: [AxisName; 3] = [AxisName::Z, AxisName::X, AxisName::Y];
const READ: [AxisName; 2] = [AxisName::C, AxisName::B];

/// A cycle on a machine whose axes move to and fro.
struct Moving {
    cycle: Cycle,
    clock: Clock,
    /// Faults of the read-only controller, if any.
    reader: Option<Injected>,
}

fn at(names: &[AxisName], coordinates: &[f64]) -> PerChannel<f64> {
    PerChannel::from_fn(|i| {
        names.get(i).map_or(0.0, |name| {
            Displacement::from_coordinate(name.kind(), coordinates[i]).mm_or_rad()
        })
    })
}

fn program(names: &[AxisName], ends: [&[f64]; 2], seconds: f64) -> Vec<Move> {
    let ends = ends.map(|end| at(names, end));
    let way = PerChannel::from_fn(|i| ends[1][i] - ends[0][i]);
    let length = way.iter().map(|x| x * x).sum::<f64>().sqrt();
    let moves = ends.map(|to| Move { to, feed_per_s: length / seconds, dwell: Duration::ZERO });
    moves.to_vec()
}

impl Moving {
    /// A control that writes X, Y and Z. B and C are read by this control or, if `beside`, by another controller.
    fn new(beside: bool, seconds: f64) -> Self {
        let clock = Clock::manual();
        let guard = guard();
        let model = Model::new(&machine(), guard.fading).expect("compiles");
        let linear = [[-80.0, 150.0, 250.0], [-300.0, 250.0, 380.0]];
        let rotary = [[-70.0, 20.0], [120.0, 75.0]];
        let (path, readers, reader) = if beside {
            let moves = program(&WRITTEN, [&linear[0], &linear[1]], seconds);
            let control = simulated_control(&WRITTEN, moves, &clock);
            let (path, _) = path_of(control, &model, &guard, &alone());
            let moves = program(&READ, [&rotary[0], &rotary[1]], seconds);
            let control = Writes::first(0, simulated_control(&READ, moves, &clock));
            let injected = Injected::default();
            let control = injected.disturb(control);
            let described = control.description().clone();
            let plan = ReaderPlan::new(described, &model, &PathSettings::default());
            let reader = PositionReader::new(Box::new(control), &plan.expect("fits"));
            (path, vec![reader], Some(injected))
        } else {
            let names = [&WRITTEN[..], &READ].concat();
            let ends = [0, 1].map(|end| [&linear[end][..], &rotary[end]].concat());
            let moves = program(&names, [&ends[0], &ends[1]], seconds);
            let control = Writes::first(3, simulated_control(&names, moves, &clock));
            let (path, _) = path_of(control, &model, &guard, &alone());
            (path, Vec::new(), None)
        };
        let cycle = cycle_of(model, &guard, vec![path]).expect("one path");
        let cycle = cycle.with_readers(readers).expect("few");
        Self { cycle: cycle.with_start(clock.start()), clock, reader }
    }

    fn step(&mut self, request: Option<Request>) -> Report {
        step(&mut self.cycle, &self.clock, request)
    }

    fn run(&mut self, cycles: u32) -> Report {
        (1..cycles).for_each(|_| {
            self.step(None);
        });
        self.step(None)
    }
}

/// With rotary axes that only this path or another controller reads, and that move, the tip error falls from above 10 to below 1 µm.
#[test]
fn the_tip_is_corrected_at_the_positions_of_read_only_axes() {
    for beside in [false, true] {
        let mut moving = Moving::new(beside, 20.0);
        moving.run(20);
        moving.step(Some(Request::Arm));
        moving.run(500);
        let (mut with, mut without, mut turned) = (0.0_f64, 0.0_f64, [f64::MAX, f64::MIN]);
        let machine = machine();
        let c = machine.index_of(AxisName::C).expect("an axis");
        for _ in 0..4500 {
            let report = moving.step(None);
            assert_eq!(report.state, State::Compensating, "{:?}", report.reasons);
            with = with.max(tip_mm(report.residual));
            without = without.max(tip_mm(report.error));
            let at = report.positions[c];
            turned = [turned[0].min(at), turned[1].max(at)];
            for name in READ {
                let axis = machine.index_of(name).expect("an axis");
                assert_eq!(report.sent.expect("it corrects")[axis], 0.0, "{name} is not written");
            }
        }
        assert!(turned[1] - turned[0] > 2.5, "it turned: {turned:?}");
        // The positions lag by one cycle, and the last write has no effect yet.
        assert!(without > 0.010 && with < 1e-3, "{without} {with}");
    }
}

#[test]
fn positions_of_a_silent_reader_expire() {
    let mut moving = Moving::new(true, 600.0);
    moving.run(20);
    moving.step(Some(Request::Arm));
    assert_eq!(moving.run(500).state, State::Compensating);
    let reader = moving.reader.clone().expect("beside");
    reader.set_silent(true);
    let report = moving.run(20);
    assert_eq!(report.state.name(), "holding", "{:?}", report.reasons);
    assert!(report.reasons.contains(Reasons::POSITIONS_STALE));
    let report = moving.run(400);
    // The correction is zero after `zero_after` and a ramp.
    assert_eq!(report.correction, PerAxis::ZERO);
    assert!(report.reasons.contains(Reasons::POSITIONS_LOST));
    reader.set_silent(false);
    assert_eq!(moving.run(500).state, State::Compensating);
    // Interlocks of the read-only controller hold the correction like those of the path.
    reader.set_stopped(true);
    let report = moving.run(5);
    assert!(report.reasons.contains(Reasons::EMERGENCY_STOP));
    let held = report.correction;
    assert_eq!(moving.run(50).correction, held);
    // Silence does not lift the interlock.
    reader.set_silent(true);
    let report = moving.run(5);
    assert!(report.reasons.contains(Reasons::INTERLOCK_UNSEEN));
}
