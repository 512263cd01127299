//! Limits change while the machine is corrected; the reversal threshold depends on them.

use std::{collections::VecDeque, time::Duration};

use volcomp_model::{Fading, Machine};
use volcomp_port::{Clock, Description, Fault, Snapshot};
use volcomp_runtime::{
    AxisSettings, Cycle, GuardSettings, Model, PathPlan, PathSettings, WithoutBarrier,
    guard::Request,
};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerChannel, Um, Urad};

use crate::{
    rig::{PERIOD, alone, referenced, without_barrier},
    ways::{Plant, Ways},
};

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
