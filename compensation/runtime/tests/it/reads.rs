//! Axes that are read and never written: the correction of the other axes is that for their current positions.

use std::time::Duration;

use volcomp_port::{Clock, Controller, simulated::Move};
use volcomp_runtime::{
    Cycle, Model, PathSettings, PositionReader, ReaderPlan, Report,
    guard::{Reasons, Request, State},
};
use volcomp_vocabulary::{AxisName, Displacement, PerAxis, PerChannel};

use crate::rig::{
    Injected, Writes, alone, cycle_of, guard, machine, path_of, simulated_control, step, tip_mm,
};

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
