//! Two ways to one control, the second of which writes fewer axes than the first.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_model::Machine;
use volcomp_port::{Clock, Controller, Description, Fault, Snapshot};
use volcomp_runtime::{
    Asked, AxisSettings, ControlPath, Cycle, GuardSettings, Model, PathPlan, PathSettings,
    PlanError, Report, Sensors,
    guard::{ControlTimeOut, Reasons, Request, State},
};
use volcomp_vocabulary::{AxisName, PerChannel, Um};

use crate::rig::{PERIOD, alone, referenced, without_barrier};

/// Z needs +20 µm at X 10 mm.
const MACHINE: &str = "structure = \"w X' Y' b Z t\"
axes = { X.travel = [0, 100], Y.travel = [0, 500], Z.travel = [0, 400] }
errors = { EZX = { poly = [-25, 0.5] } }";
const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
/// So long after its last write the first way goes to zero, and so long it takes.
const TIME_OUT: ControlTimeOut = ControlTimeOut {
    after: Duration::from_millis(200),
    to_zero: Duration::from_millis(100),
};

/// The control: its words, when they were written last, and whether the first way is away.
#[derive(Default)]
struct Plant {
    words: PerChannel<f64>,
    written: Duration,
    first_is_away: bool,
}

struct Way {
    plant: Arc<Mutex<Plant>>,
    clock: Clock,
    description: Description,
}

impl Way {
    fn is_first(&self) -> bool {
        self.description.axes.len() == AXES.len()
    }

    fn is_away(&self) -> bool {
        self.is_first() && self.plant.lock().expect("no panic").first_is_away
    }
}

impl Controller for Way {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _: Instant) -> Result<Snapshot, Fault> {
        if self.is_away() {
            return Err(Fault::TimedOut);
        }
        let words = self.plant.lock().expect("no panic").words;
        let applied = self.description.tells_applied.then_some(words);
        let positions = PerChannel::leading([10.0]);
        Ok(referenced(positions, self.clock.now(), applied))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        if self.is_away() {
            return Err(Fault::TimedOut);
        }
        let mut plant = self.plant.lock().expect("no panic");
        let count = self.description.axes.len();
        plant.words[..count].copy_from_slice(&corrections[..count]);
        if self.is_first() {
            plant.written = self.clock.elapsed();
        }
        Ok(())
    }
}

/// The first way goes to zero by itself where it has a time-out.
fn cycle(
    axes: [&[AxisName]; 2],
    time_out: Option<ControlTimeOut>,
    plant: &Arc<Mutex<Plant>>,
    clock: &Clock,
) -> Result<Cycle, PlanError> {
    let mut guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    let machine = Machine::parse(MACHINE, "m").expect("valid");
    let model = Model::new(&machine, guard.fading).expect("compiles");
    let paths = axes.map(|axes| {
        let others = AXES.iter().filter(|name| !axes.contains(name));
        let time_out = time_out.filter(|_| axes.len() == AXES.len());
        let description = Description {
            reads: others.copied().collect(),
            tells_applied: time_out.is_none(),
            ..without_barrier("control", axes)
        };
        let settings = PathSettings {
            time_out,
            ..alone()
        };
        let plan = PathPlan::new(description.clone(), &model, &guard, &settings, PERIOD);
        let way = Way {
            plant: Arc::clone(plant),
            clock: clock.clone(),
            description,
        };
        ControlPath::new(Box::new(way), &plan.expect("fits")).expect("fits")
    });
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    let cycle = Cycle::new(
        Box::new(model),
        Vec::from(paths),
        guard.hand_back,
        sensors,
        PERIOD,
    )?;
    Ok(cycle.with_clock(clock.clone()))
}

/// The words of Z stayed at 20 µm for good, and 0 µm was shown.
#[test]
fn a_path_whose_axes_another_does_not_write_must_go_to_zero_by_itself() {
    let plant = Arc::new(Mutex::new(Plant::default()));
    let made = |axes, time_out| cycle(axes, time_out, &plant, &Clock::manual());
    let few = &AXES[..2];
    for axes in [[&AXES[..], few], [few, &AXES[..]]] {
        let refused = made(axes, None).map(|_| ()).expect_err("Z would be left");
        assert!(
            matches!(
                refused,
                PlanError::LeavesAxis {
                    axis: AxisName::Z,
                    ..
                }
            ),
            "{refused}"
        );
        assert!(made(axes, Some(TIME_OUT)).is_ok(), "it goes to zero");
    }
    let other_order = [AxisName::Z, AxisName::X, AxisName::Y];
    assert!(made([&AXES, &other_order], None).is_ok());
}

/// The first way holds 20 µm on Z when it falls silent; the second writes X and Y.
#[test]
fn fewer_axes_take_over_once_the_others_are_at_zero() {
    let plant = Arc::new(Mutex::new(Plant::default()));
    let clock = Clock::manual();
    let mut cycle = cycle([&AXES, &AXES[..2]], Some(TIME_OUT), &plant, &clock).expect("fits");
    let mut reports: Vec<Report> = Vec::new();
    for number in 0..1500 {
        clock.advance(PERIOD);
        {
            let mut plant = plant.lock().expect("no panic");
            plant.first_is_away = number >= 1000;
            let silent = clock.elapsed().saturating_sub(plant.written);
            if silent > TIME_OUT.after + TIME_OUT.to_zero {
                plant.words[2] = 0.0;
            }
        }
        let asked = Asked {
            request: (number == 50).then_some(Request::Arm),
            ..Asked::default()
        };
        cycle.run(clock.now(), &asked, &mut || Duration::ZERO);
        let report = *cycle.report();
        let word = plant.lock().expect("no panic").words[2];
        assert!(
            report.active == 0 || word == 0.0,
            "cycle {number}: {word} mm are left on Z"
        );
        reports.push(report);
    }
    assert!((reports[999].correction[2] - 0.020).abs() < 0.001);
    let waits = reports[1050].reasons;
    assert!(waits.contains(Reasons::OTHER_CHANNEL_UNKNOWN), "{waits:?}");
    let last = &reports[1499];
    assert_eq!((last.state, last.active), (State::Compensating, 1));
}
