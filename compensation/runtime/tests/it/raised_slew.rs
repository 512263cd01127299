//! Limits that are changed while the machine is corrected, and the threshold of a reversal, which depends on them.

use std::{
    collections::VecDeque,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use volcomp_model::{Fading, Machine};
use volcomp_port::{Clock, Controller, Description, Fault, Snapshot};
use volcomp_runtime::{
    Asked, AxisSettings, ControlPath, Cycle, GuardSettings, Model, PathPlan, PathSettings, Sensors,
    WithoutBarrier, guard::Request,
};
use volcomp_vocabulary::{AxisName, Displacement, Mm, PerChannel, Um, Urad};

use crate::rig::{PERIOD, referenced, without_barrier};

/// Tells positions that contain the correction as it was eight readings ago; words can be read back at once.
struct Lagging {
    description: Description,
    clock: Clock,
    applied: Arc<Mutex<PerChannel<f64>>>,
    seen: VecDeque<f64>,
    command_mm: Arc<AtomicU64>,
}

impl Controller for Lagging {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _: Instant) -> Result<Snapshot, Fault> {
        let applied = *self.applied.lock().expect("no panic");
        self.seen.push_back(applied[0]);
        let contained = self.seen.pop_front().unwrap_or_default();
        let command = f64::from_bits(self.command_mm.load(Ordering::Relaxed));
        let mut positions = PerChannel::ZERO;
        positions[0] = ((command + contained) * 1e3).round() * 1e-3;
        Ok(referenced(positions, self.clock.now(), Some(applied)))
    }

    fn apply(&mut self, correction: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        *self.applied.lock().expect("no panic") = *correction;
        Ok(())
    }
}

/// How often the wanted correction changes its sign within 8 s of standstill, after the slew was changed.
fn turns(slew_before: f64, slew_after: f64) -> usize {
    let text = "structure = \"w X' b Y Z t\"
axes = { X.travel = [0.0, 800.0], Y.travel = [0.0, 400.0], Z.travel = [0.0, 250.0] }
errors = { EXX = { mean = { poly = [0.0] }, reversal = 20.0 } }
";
    let machine = Machine::parse(text, "m").expect("valid");
    let model = Model::new(&machine, Fading::default()).expect("compiles");
    let clock = Clock::manual();
    let guard = |slew: f64| GuardSettings {
        without_barrier: WithoutBarrier {
            linear: Um(100.0),
            rotary: Urad(30.0),
        },
        ramp: Duration::from_millis(100),
        ..GuardSettings::new(AxisSettings::new(Um(100.0), Um(slew)))
    };
    let mut description = without_barrier("lagging", &[AxisName::X]);
    description.axes[0].includes_correction = true;
    let ten = Displacement::Length(Mm(10.0));
    let settings = PathSettings {
        fixed: [(AxisName::Y, ten), (AxisName::Z, ten)].into(),
        watch: Duration::ZERO,
        read_back_cycles: 10,
        ..PathSettings::default()
    };
    let plan = |slew: f64| {
        PathPlan::new(description.clone(), &model, &guard(slew), &settings, PERIOD).expect("fits")
    };
    let command_mm = Arc::new(AtomicU64::new(100.0_f64.to_bits()));
    let control = Lagging {
        description: description.clone(),
        clock: clock.clone(),
        applied: Arc::default(),
        seen: VecDeque::from(vec![0.0; 8]),
        command_mm: Arc::clone(&command_mm),
    };
    let path = ControlPath::new(Box::new(control), &plan(slew_before)).expect("fits");
    let settings = guard(slew_before);
    let sensors = Sensors::new(Vec::new(), settings.temperatures);
    let cycle = Cycle::new(
        Box::new(model.clone()),
        vec![path],
        settings.hand_back,
        sensors,
        PERIOD,
    );
    let mut cycle = cycle.expect("one path").with_start(clock.start());
    let step = |cycle: &mut Cycle, request: Option<Request>| {
        clock.advance(PERIOD);
        let asked = Asked {
            request,
            ..Asked::default()
        };
        cycle.run(clock.now(), &asked, &mut || Duration::ZERO);
        *cycle.report()
    };
    // Three readings, each as far apart as a reading may be behind.
    for _ in 0..40 {
        step(&mut cycle, None);
    }
    step(&mut cycle, Some(Request::Arm));
    for _ in 0..500 {
        step(&mut cycle, None);
    }
    cycle
        .set_limits(0, &plan(slew_after).limits)
        .expect("taken");
    step(&mut cycle, Some(Request::Switched));
    for _ in 0..500 {
        step(&mut cycle, None);
    }
    // The axis goes forward by 0.1 mm and back by 0.08 mm, then it stands.
    for k in 0..300_u32 {
        let back = if k > 100 { 0.08 } else { 0.0 };
        let at = 100.0 + 0.002 * f64::from(k.min(50)) - back;
        command_mm.store(at.to_bits(), Ordering::Relaxed);
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

/// A slew that is raised by a reload: what it moves within the delay of the read-back was taken for a reversal, 222 times
/// in 8 s.
#[test]
fn a_raised_slew_feeds_no_reversal_back() {
    assert_eq!(turns(2000.0, 2000.0), 0, "planned for that slew");
    assert_eq!(turns(50.0, 50.0), 0, "slow");
    assert_eq!(turns(50.0, 2000.0), 0, "raised");
}
