//! Plans of controllers without a barrier whose rotary axes do not correct.

use std::{collections::VecDeque, time::Duration};

use volcomp_port::{Axis, Clock, Controller, Description, Fault, Snapshot, Words};
use volcomp_runtime::{
    AxisSettings, BarrierSettings, Cycle, GuardSettings, Model, PathPlan, PathSettings, PlanError,
    WithoutBarrier,
    guard::{
        Limits, Request,
        barrier::{Barrier, Counts, Layout, REPORT_WORDS, Settings},
    },
};
use volcomp_vocabulary::{AxisName, Displacement, MAX_AXES, PerChannel, Um, Urad};

use crate::{
    rig::{NAMES, PERIOD, alone, control, guard, machine, referenced, without_barrier},
    ways::{AXES, Plant, Ways, three_axes},
};

/// The plan for a control of the five-axis machine whose rotary axes have steps of so many µrad.
fn plan(
    step_urad: f64,
    barrier: bool,
    rotary: Option<AxisSettings<Urad>>,
) -> Result<PathPlan, PlanError> {
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
    description.axes = NAMES.iter().map(of).collect();
    description.barrier = barrier;
    let mut guard = guard();
    guard.rotary = rotary;
    guard.rotary_step = Um(5.0);
    // As shipped.
    guard.without_barrier = WithoutBarrier::default();
    let model = Model::new(&machine, guard.fading).expect("compiles");
    let mut settings = alone();
    settings.barrier = barrier.then_some(volcomp_runtime::BarrierSettings {
        machine: 1,
        scan: std::time::Duration::from_millis(2),
    });
    PathPlan::new(description, &model, &guard, &settings, PERIOD)
}

/// Rotary axes in steps of 0.01 degrees are not corrected, since half a step moves the tip too far: they need no limits.
#[test]
fn rotary_axes_that_are_too_coarse_to_correct_need_no_limits_without_a_barrier() {
    let step_urad = 0.01_f64.to_radians() * 1e6;
    let stated = AxisSettings::new(Urad(250.0), Urad(500.0));
    for barrier in [true, false] {
        for rotary in [Some(stated), None] {
            let plan = plan(step_urad, barrier, rotary);
            let told = plan
                .as_ref()
                .map(|plan| plan.left_out.len())
                .map_err(ToString::to_string);
            assert_eq!(
                told,
                Ok(2),
                "barrier {barrier}, limits {}",
                rotary.is_some()
            );
        }
    }
}

/// Two ways to the barrier of one control; reports and frames are some cycles on their way.
struct Slow {
    barrier: Barrier,
    x: f64,
    late: usize,
    first_is_away: bool,
    reports: VecDeque<Words>,
    air: VecDeque<(usize, Vec<u16>)>,
    mailboxes: [Option<Vec<u16>>; 2],
    cycle: usize,
}

impl Slow {
    fn new(late: usize) -> Self {
        let settings = Settings {
            axes: Layout::of(AXES).expect("each once"),
            machine: 1,
            limit: PerChannel([150; MAX_AXES]),
            rate: PerChannel([2; MAX_AXES]),
            step_scans: 1,
            hold_scans: 50,
            time_out_scans: 100,
        };
        Self {
            barrier: Barrier::start(settings, 1, 0, &Counts::default()).expect("good settings"),
            x: 0.0,
            late,
            first_is_away: false,
            reports: VecDeque::new(),
            air: VecDeque::new(),
            mailboxes: [None, None],
            cycle: 0,
        }
    }

    fn cycle(&mut self) {
        self.cycle += 1;
        while self.air.front().is_some_and(|(at, _)| *at <= self.cycle) {
            if let Some((_, words)) = self.air.pop_front() {
                self.mailboxes[0] = Some(words);
            }
        }
        for _ in 0..2 {
            let boxes: Vec<&[u16]> = self.mailboxes.iter().flatten().map(Vec::as_slice).collect();
            self.barrier.scan(&boxes, false);
        }
        let mut words = [0; REPORT_WORDS];
        let length = self.barrier.report().encode(&mut words);
        self.reports
            .push_back(Words::new(&words[..length]).expect("fits"));
        while self.reports.len() > self.late + 1 {
            self.reports.pop_front();
        }
    }
}

impl Plant for Slow {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        if way.device == "first" && self.first_is_away {
            return Err(Fault::TimedOut);
        }
        let mut snapshot = referenced(PerChannel::leading([self.x]), clock.now(), None);
        snapshot.report = self.reports.front().cloned();
        Ok(snapshot)
    }

    fn post(&mut self, way: &Description, frame: &Words) -> Result<(), Fault> {
        if way.device == "first" && self.first_is_away {
            return Err(Fault::TimedOut);
        }
        self.air
            .push_back((self.cycle + self.late, frame.as_slice().to_vec()));
        Ok(())
    }

    fn apply(&mut self, _: &Description, _: &PerChannel<f64>, _: &Clock) -> Result<(), Fault> {
        Ok(())
    }
}

fn slow_ways(late: usize) -> (Ways<Slow>, Cycle, Limits) {
    let ways = Ways::to(Slow::new(late), Clock::manual());
    let mut guard = GuardSettings::new(AxisSettings::new(Um(150.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    guard.hand_back = Duration::from_secs(2);
    let model = three_axes("EXX = { poly = [-75, 1.5] }", &guard);
    let settings = PathSettings {
        barrier: Some(BarrierSettings {
            machine: 1,
            scan: Duration::from_millis(2),
        }),
        read_back_cycles: 2 * late + 2,
        proves: false,
        ..alone()
    };
    let describe = |device| Description {
        barrier: true,
        ..without_barrier(device, &AXES)
    };
    let plan = PathPlan::new(describe("first"), &model, &guard, &settings, PERIOD).expect("fits");
    let paths =
        ["first", "second"].map(|device| ways.path(describe(device), &model, &guard, &settings));
    let cycle = ways.cycle(model, &guard, paths.into()).expect("fits");
    (ways, cycle, plan.limits)
}

/// X travels up for 80 cycles and down for 80; the correction follows by less than its slew. The way is handed back meanwhile:
/// how far the axis then goes against its way, counts, where it does not turn about that time.
#[test]
fn a_way_that_is_handed_back_in_motion_leads_no_axis_back() {
    let mut worst = (0, String::new());
    let mut looked = 0;
    for late in [0, 2, 4, 6] {
        for offset in [0, 20, 40, 60] {
            let (ways, mut cycle, _) = slow_ways(late);
            let mut applied = Vec::new();
            let mut handed_back = None;
            let mut active = 0;
            for number in 0..2200_usize {
                {
                    let mut plant = ways.plant();
                    let phase = (number + offset) % 160;
                    let up = if phase < 80 { phase } else { 160 - phase };
                    plant.x = 10.0 + up as f64;
                    plant.first_is_away = (900..1150).contains(&number);
                    plant.cycle();
                    applied.push(plant.barrier.memory().applied[0]);
                }
                let report = ways.step(&mut cycle, (number == 600).then_some(Request::Arm));
                if active == 1 && report.active == 0 {
                    assert!(report.state.is_armed(), "{:?}", report.state);
                    handed_back = Some(number);
                }
                active = report.active;
            }
            let at = handed_back.expect("handed back");
            let phase = (at + offset) % 80;
            if !(25..50).contains(&phase) {
                continue;
            }
            looked += 1;
            let sign = (applied[at] - applied[at - 10]).signum();
            let mut furthest = applied[at - 10] * sign;
            let mut back = 0;
            for value in &applied[at - 10..at + 20] {
                furthest = furthest.max(value * sign);
                back = back.max(furthest - value * sign);
            }
            if back > worst.0 {
                worst = (
                    back,
                    format!(
                        "{late} late, offset {offset}: {:?}",
                        &applied[at - 10..at + 30]
                    ),
                );
            }
        }
    }
    assert!(looked > 0);
    assert!(worst.0 <= 2, "{} um back: {}", worst.0, worst.1);
}

/// Other limits with a lower slew, given in motion: frames go on, so the barrier never has to let go.
#[test]
fn a_slew_lowered_in_motion_loses_no_correction() {
    let mut wrong = Vec::new();
    for (late, part) in [
        (0, 0.02),
        (2, 0.02),
        (2, 0.1),
        (4, 0.02),
        (4, 0.1),
        (6, 0.1),
    ] {
        let (ways, mut cycle, mut limits) = slow_ways(late);
        for axis in &mut limits.axes {
            axis.slew_per_s *= part;
        }
        let (mut states, mut before) = (Vec::new(), (0, 0));
        let mut applied = 0;
        for number in 0..2500_usize {
            {
                let mut plant = ways.plant();
                // 1.5 um in a cycle, then it stands where 60 um are wanted.
                plant.x = 10.0 + number.saturating_sub(900).min(80) as f64;
                plant.cycle();
                applied = plant.barrier.memory().applied[0];
                if number == 970 {
                    before = (applied, plant.barrier.memory().epoch);
                }
            }
            let mut request = (number == 600).then_some(Request::Arm);
            if number == 970 {
                cycle.set_limits(0, &limits).expect("lower");
                request = Some(Request::Switched);
            }
            let report = ways.step(&mut cycle, request);
            if number > 930 && states.last() != Some(&report.state) {
                states.push(report.state);
            }
        }
        let (at, epoch) = before;
        if ways.plant().barrier.memory().epoch != epoch {
            wrong.push(format!(
                "{late} late, slew x {part}: the barrier let go of {at} um, 6 s later {applied} um, {states:?}"
            ));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// An indexing axis in steps of 0.2 degrees is not corrected and needs no limits, behind a barrier either.
#[test]
fn an_indexing_axis_that_does_not_correct_needs_no_limits() {
    let step_urad = 0.2_f64.to_radians() * 1e6;
    let told = plan(step_urad, true, None);
    let told = told
        .as_ref()
        .map(|plan| plan.left_out.len())
        .map_err(ToString::to_string);
    assert_eq!(told, Ok(2));
}
