//! Corrections that limits reduce: errors are evaluated at the position that the axes actually reach.
//!
//! The correction of a rotary axis that stops correcting ramps out together with the linear axes that compensate it.
//! The limits may change while the machine is corrected; the reversal threshold depends on them.

use std::{collections::VecDeque, time::Duration};

use volcomp_guard::{AxisLimits, Limits, RequestedCorrection, Vector};
use volcomp_kinematics::actual_pose;
use volcomp_model::{Fading, Machine, Temperatures};
use volcomp_port::{Clock, Description, Fault, Snapshot};
use volcomp_runtime::{
    AxisSettings, Cycle, GuardSettings, Model, PathPlan, PathSettings, Report, WithoutBarrier,
    guard::{Reasons, Request},
    kinematics::State,
};
use volcomp_vocabulary::{
    AxisKind, AxisName, Displacement, MAX_AXES, Mm, PerAxis, PerChannel, Um, Urad,
};

use crate::{
    rig::{NAMES, PERIOD, Rig, alone, guard, referenced, without_barrier},
    ways::{Plant, Ways},
};

/// Position error of the tool with a correction, µm, by the exact chain.
fn off_um(machine: &Machine, state: &State, delta: &PerAxis<f64>) -> f64 {
    let mut there = *state;
    for i in 0..MAX_AXES {
        there.q[i] += delta[i];
    }
    let chain = machine.chain();
    let temperatures = Temperatures::new();
    let tip = chain.tool_tip_mm();
    let actual = actual_pose(chain, &machine.source(&temperatures), &there);
    (actual.transform_point(&tip) - chain.ideal_pose(state).transform_point(&tip)).norm() * 1e3
}

/// A machine with a tilting table and periodic screw errors.
const PERIODIC: &str = "structure = \"w C' A' b X Y Z t\"
axes.X = { travel = [-500.0, 500.0] }
axes.Y = { travel = [-500.0, 500.0] }
axes.Z = { travel = [-500.0, 500.0] }
axes.A = { travel = [-120.0, 30.0], point = [0.0, 0.0, -100.0] }
axes.C = { travel = [0.0, 360.0], modulo = 360.0 }
tool.tip = [0.0, 0.0, 0.0]
[errors]
EXX = { fourier = [0.0, 0.0, 5.0], period = 10.0 }
EYY = { fourier = [0.0, 0.0, 5.0], period = 10.0 }
EBZ = 100.0
";

/// Near the singular pose a limit clips most of the correction of C: the remaining error is below 0.2 µm. Errors evaluated at the
/// unlimited correction would cause 4.6 µm.
#[test]
fn a_limit_near_the_singular_pose_makes_no_error() {
    let machine = Machine::parse(PERIODIC, "m").expect("valid");
    let model = Model::new(&machine, Fading::default()).expect("compiles");
    let correctors = model.correctors_among(&model.axes);
    let place = |name: AxisName| model.index_of(name).expect("an axis");
    let [mut moving, mut settled] = [f64::NEG_INFINITY; 2];
    for (a_deg, limit_urad) in [(1.3_f64, 250.0), (1.3, 2000.0), (2.0, 250.0), (6.0, 250.0)] {
        for step in 0..40 {
            let mut state = State::default();
            state.q[place(AxisName::A)] = a_deg.to_radians();
            state.q[place(AxisName::C)] = 0.5;
            state.q[place(AxisName::X)] = 300.0 + f64::from(step % 20) * 0.5;
            state.q[place(AxisName::Y)] = 250.0 + f64::from(step / 20) * 5.0;
            let axes = std::array::from_fn(|i| {
                let Some(name) = model.axes.get(i) else {
                    return AxisLimits::NONE;
                };
                let [limit, slew_per_s, resolution] = match name.kind() {
                    AxisKind::Rotary => [limit_urad * 1e-6, 0.005, 1e-7],
                    AxisKind::Linear => [0.25, 5.0, 1e-5],
                };
                AxisLimits {
                    kind: name.kind(),
                    limit,
                    warn: limit,
                    slew_per_s,
                    accel_per_s2: f64::INFINITY,
                    resolution,
                    includes_correction: false,
                }
            });
            let limits = Limits {
                axes,
                count: 5,
                period: Duration::from_millis(4),
                hold: Duration::from_millis(50),
                zero_after: Duration::from_millis(500),
                ramp: Duration::from_millis(100),
                test_shift: PerChannel::ZERO,
                read_back_cycles: 1,
                only_thermal: false,
            };
            let mut vector = Vector::at(&PerChannel::ZERO);
            let without = off_um(&machine, &state, &PerAxis::ZERO);
            for cycle in 0..200 {
                let wanted = model.wanted(&state, &correctors, &PerAxis(vector.output().0));
                let wanted = RequestedCorrection {
                    position: PerChannel(wanted.position.0),
                    rotary: PerChannel(wanted.rotary.0),
                    follow: PerChannel(wanted.follow.0.map(|row| PerChannel(row.0))),
                };
                let followed = vector.follow(&wanted, &limits, 0.004);
                let with = off_um(&machine, &state, &PerAxis(vector.output().0));
                let worst = if cycle < 150 { &mut moving } else { &mut settled };
                if !followed.behind {
                    *worst = worst.max(with - without);
                }
            }
        }
    }
    println!("over what is without: {moving} µm on the ramp, {settled} µm after it");
    // Second order: rotary corrections of up to 2 mrad turn linear ones of up to 0.1 mm; on a ramp the errors are those of the previous
    // cycle.
    assert!(settled < 0.2 && moving < 0.2, "{settled} µm, {moving} µm");
}

const PLACE: [f64; 5] = [-100.0, 0.0, 200.0, 50.0, 300.0];
const TABLE_AND_HEAD: &str = "structure = \"w C' X' b Y Z B t\"
axes.X = { travel = [0.0, 800.0] }
axes.Y = { travel = [0.0, 600.0] }
axes.Z = { travel = [-500.0, 0.0], point = [400.0, 300.0, -120.0] }
axes.B = { travel = [-110.0, 110.0], point = [400.0, 300.0, 120.0] }
axes.C = { travel = [0.0, 360.0], point = [400.0, 300.0, 0.0], modulo = 360.0 }
tool = { gauge = [400.0, 300.0, 0.0], length = 120.0 }
errors = { EBZ = -160.0 }
";

/// A corrected machine whose B axis has a correction, its pose, and the bound on the tool error from then on.
struct Holding {
    rig: Rig,
    machine: Machine,
    state: State,
    bound_um: f64,
}

impl Holding {
    /// A machine with this slew and acceleration of the rotary axes, µrad/s and µrad/s².
    fn new(slew_urad: f64, accel: f64) -> Self {
        let machine = Machine::parse(TABLE_AND_HEAD, "m").expect("valid");
        let mut state = State::default();
        for (q, joint) in state.q.iter_mut().zip(machine.chain().joints()) {
            let at = NAMES.iter().zip(PLACE).find(|(name, _)| **name == joint.name);
            let (name, at) = at.expect("its axis");
            *q = Displacement::from_coordinate(name.kind(), at).mm_or_rad();
        }
        let mut settings = guard();
        settings.linear.test_shift = Um(5.0);
        settings.rotary = Some(AxisSettings {
            accel_per_s2: Urad(accel),
            test_shift: Urad(5.0),
            ..AxisSettings::new(Urad(250.0), Urad(slew_urad))
        });
        let mut rig = Rig::of(&machine, &settings, PLACE, &NAMES);
        let report = rig.arm(2000);
        assert_eq!(report.state.name(), "compensating");
        let b = machine.index_of(AxisName::B).expect("an axis");
        assert!(report.correction[b].abs() > 1e-4, "B holds a share");
        let off = |correction| off_um(&machine, &state, correction);
        let bound_um = off(&PerAxis::ZERO).max(off(&report.correction));
        Self { rig, machine, state, bound_um }
    }

    fn corrects(&mut self, axes: &str) {
        let text = format!("correct = [{axes}]\n{TABLE_AND_HEAD}");
        let machine = Machine::parse(&text, "m").expect("valid");
        self.rig.swap(&machine);
    }

    /// Runs cycles, the first with a request, and checks the tool error against its bound; returns the last report.
    fn run(&mut self, request: Request, cycles: u32, what: &str) -> Report {
        let mut report = self.rig.step(Some(request));
        let mut worst = 0.0_f64;
        for _ in 0..cycles {
            worst = worst.max(off_um(&self.machine, &self.state, &report.correction));
            report = self.rig.step(None);
        }
        println!("{what}: {worst} µm, {} µm before", self.bound_um);
        assert!(worst <= self.bound_um + 0.1, "{what}: {worst} of {} µm", self.bound_um);
        report
    }

    fn of(&self, report: &Report, name: AxisName) -> f64 {
        report.correction[self.machine.index_of(name).expect("an axis")]
    }
}

/// Slew and acceleration of the rotary axes, µrad/s and µrad/s².
const PACES: [(f64, f64); 3] = [(500.0, f64::INFINITY), (100.0, f64::INFINITY), (500.0, 1000.0)];

/// A new machine file removes the rotary axes from `correct`: they ramp out with the linear axes that follow them. Alone, at 100 µrad/s,
/// they would move the tool by 26 µm.
#[test]
fn rotary_axes_that_stop_correcting_ramp_out_with_the_linear_axes() {
    for (slew, accel) in PACES {
        let mut holding = Holding::new(slew, accel);
        holding.corrects("\"X\", \"Y\", \"Z\"");
        let report = holding.run(Request::Switched, 3000, &format!("{slew}, {accel}"));
        assert_eq!(holding.of(&report, AxisName::B), 0.0);
    }
}

/// A new machine file removes a linear axis from `correct`. Two linear axes cannot follow rotary ones, so these ramp out too; with
/// separate ramps the tool would be off by tens of µm.
#[test]
fn a_linear_axis_that_stops_correcting_ramps_out_with_the_rotary_axes() {
    for (slew, accel) in PACES {
        for left in ["\"Y\", \"Z\"", "\"X\", \"Z\", \"B\", \"C\"", "\"X\", \"Y\", \"B\"", "\"Z\""] {
            let mut holding = Holding::new(slew, accel);
            holding.corrects(left);
            let what = format!("{slew}, {accel}: {left}");
            let report = holding.run(Request::Switched, 3000, &what);
            assert_eq!(holding.of(&report, AxisName::B), 0.0);
            for name in [AxisName::X, AxisName::Y, AxisName::Z] {
                let corrects = left.contains(&format!("\"{name}\""));
                assert!(corrects || holding.of(&report, name) == 0.0, "{name}");
            }
        }
    }
}

#[test]
fn axes_that_stop_correcting_in_turn_do_not_move_the_tip() {
    let mut holding = Holding::new(100.0, f64::INFINITY);
    for left in ["\"Y\", \"Z\"", "\"Z\"", "\"X\", \"Y\", \"Z\""] {
        holding.corrects(left);
        holding.run(Request::Switched, 130, left);
    }
}

/// Limits are lowered during a ramp-out and the gateway is armed again: the whole correction is reduced together before the test shift,
/// since a rotary axis alone would move the tool by tens of µm.
#[test]
fn limits_lowered_before_arming_reduce_the_whole_correction() {
    for (slew, accel) in PACES {
        for (linear, rotary) in [(1.0, 0.2), (0.1, 1.0), (0.1, 0.3)] {
            let mut holding = Holding::new(slew, accel);
            let what = format!("{slew}, {accel}: {linear} {rotary}");
            holding.run(Request::Disarm, 2, &what);
            let mut limits = holding.rig.limits;
            for axis in limits.axes.iter_mut().take(limits.count) {
                axis.limit *= match axis.kind {
                    AxisKind::Linear => linear,
                    AxisKind::Rotary => rotary,
                };
                axis.warn = axis.limit;
            }
            holding.rig.cycle.set_limits(0, &limits).expect("lower");
            let report = holding.run(Request::Arm, 30, &what);
            assert_eq!(report.state.name(), "arming");
            assert!(report.reasons.contains(Reasons::WAITING_FOR_STANDSTILL));
            let mut axes = limits.axes.iter().zip(NAMES);
            let is_beyond = axes.any(|(axis, name)| holding.of(&report, name).abs() > axis.limit);
            assert!(is_beyond, "{what}: it is on its way in");
            // The test shift moves each linear axis by 5 µm.
            holding.bound_um += 5.0 * 3.0_f64.sqrt();
            let report = holding.run(Request::Arm, 4000, &what);
            assert_eq!(report.state.name(), "compensating", "{what}");
        }
    }
}

/// Reports positions that contain the correction of eight readings ago; the read-back has no delay.
struct Lagging {
    applied: PerChannel<f64>,
    seen: VecDeque<f64>,
    command_mm: f64,
}

impl Plant for Lagging {
    fn read(&mut self, _: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        self.seen.push_back(self.applied[0]);
        let contained = self.seen.pop_front().unwrap_or_default();
        let position = ((self.command_mm + contained) * 1e3).round() * 1e-3;
        let positions = PerChannel::leading([position]);
        Ok(referenced(positions, clock.now(), Some(self.applied)))
    }

    fn apply(
        &mut self,
        _: &Description,
        correction: &PerChannel<f64>,
        _: &Clock,
    ) -> Result<(), Fault> {
        self.applied = *correction;
        Ok(())
    }
}

/// Number of sign changes of the requested correction in 8 s at standstill after the slew was changed.
fn turns(slew_before: f64, slew_after: f64) -> usize {
    let text = "structure = \"w X' b Y Z t\"
axes = { X.travel = [0.0, 800.0], Y.travel = [0.0, 400.0], Z.travel = [0.0, 250.0] }
errors = { EXX = { mean = { poly = [0.0] }, reversal = 20.0 } }
";
    let machine = Machine::parse(text, "m").expect("valid");
    let model = Model::new(&machine, Fading::default()).expect("compiles");
    let guard = |slew: f64| GuardSettings {
        without_barrier: WithoutBarrier { linear: Um(100.0), rotary: Urad(30.0) },
        ramp: Duration::from_millis(100),
        ..GuardSettings::new(AxisSettings::new(Um(100.0), Um(slew)))
    };
    let mut description = without_barrier("lagging", &[AxisName::X]);
    description.axes[0].includes_correction = true;
    let ten = Displacement::Length(Mm(10.0));
    let settings = PathSettings {
        fixed: [(AxisName::Y, ten), (AxisName::Z, ten)].into(),
        read_back_cycles: 10,
        ..alone()
    };
    let plan = |slew: f64| {
        PathPlan::new(description.clone(), &model, &guard(slew), &settings, PERIOD).expect("fits")
    };
    let control = Lagging {
        applied: PerChannel::ZERO,
        seen: VecDeque::from(vec![0.0; 8]),
        command_mm: 100.0,
    };
    let ways = Ways::to(control, Clock::manual());
    let path = ways.path(description.clone(), &model, &guard(slew_before), &settings);
    let cycle = ways.cycle(model.clone(), &guard(slew_before), vec![path]);
    let mut cycle = cycle.expect("one path");
    let step = |cycle: &mut Cycle, request| ways.step(cycle, request);
    // Arming needs readings that are a read-back delay apart.
    for _ in 0..40 {
        step(&mut cycle, None);
    }
    step(&mut cycle, Some(Request::Arm));
    for _ in 0..500 {
        step(&mut cycle, None);
    }
    cycle.set_limits(0, &plan(slew_after).limits).expect("taken");
    step(&mut cycle, Some(Request::Switched));
    for _ in 0..500 {
        step(&mut cycle, None);
    }
    // The axis moves forward by 0.1 mm, back by 0.08 mm, and stops.
    for k in 0..300_u32 {
        let back = if k > 100 { 0.08 } else { 0.0 };
        let at = 100.0 + 0.002 * f64::from(k.min(50)) - back;
        ways.plant().command_mm = at;
        step(&mut cycle, None);
    }
    let (mut turns, mut last) = (0, 0.0_f64);
    for _ in 0..2000 {
        let wanted = step(&mut cycle, None).wanted[0];
        turns += usize::from(wanted * last < 0.0);
        last = wanted;
    }
    assert_eq!(cycle.report().state.name(), "compensating");
    turns
}

/// A reload raises the slew: motion by the correction within the read-back delay causes no reversal.
#[test]
fn a_raised_slew_causes_no_reversal() {
    assert_eq!(turns(2000.0, 2000.0), 0, "planned for that slew");
    assert_eq!(turns(50.0, 50.0), 0, "slow");
    assert_eq!(turns(50.0, 2000.0), 0, "raised");
}
