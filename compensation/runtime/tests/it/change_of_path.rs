//! Two ways without a barrier to one control, and the axis when the way changes.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_model::Machine;
use volcomp_port::{Clock, Controller, Description, Fault, Snapshot};
use volcomp_runtime::{
    Asked, AxisSettings, ControlPath, Cycle, GuardSettings, Model, PathPlan, Sensors,
    guard::{Request, State},
};
use volcomp_vocabulary::{AxisName, PerChannel, Um};

use crate::rig::{PERIOD, alone, referenced, without_barrier};

/// The error of X changes by 0.5 µm in 1 mm.
const MACHINE: &str = "structure = \"w X' Y' b Z t\"
axes = { X.travel = [0, 100], Y.travel = [0, 500], Z.travel = [0, 400] }
errors = { EXX = { poly = [-25, 0.5] } }";

/// The control: where X is (mm), its words, and whether the first way answers.
#[derive(Default)]
struct Plant {
    x: f64,
    words: PerChannel<f64>,
    first_is_away: bool,
    /// The largest change of the word of X by one write, mm.
    largest: f64,
}

struct Way {
    is_first: bool,
    plant: Arc<Mutex<Plant>>,
    clock: Clock,
    description: Description,
}

impl Way {
    fn with<T>(&self, does: impl FnOnce(&mut Plant) -> T) -> Result<T, Fault> {
        let mut plant = self.plant.lock().expect("no panic");
        if self.is_first && plant.first_is_away {
            return Err(Fault::TimedOut);
        }
        Ok(does(&mut plant))
    }
}

impl Controller for Way {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _: Instant) -> Result<Snapshot, Fault> {
        let (x, words) = self.with(|plant| (plant.x, plant.words))?;
        Ok(referenced(
            PerChannel::leading([x]),
            self.clock.now(),
            Some(words),
        ))
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        self.with(|plant| {
            let change = (corrections[0] - plant.words[0]).abs();
            plant.largest = plant.largest.max(change);
            plant.words = *corrections;
        })
    }
}

/// X stands, travels 100 mm with 60 m/min from the cycle `begins` on, and stands. The first way is away for a second from
/// cycle 800 + `offset` on. The largest change of the axis by one write, µm.
fn largest_write_um(offset: u64, begins: u64, hand_back: Duration) -> f64 {
    let clock = Clock::manual();
    let plant = Arc::new(Mutex::new(Plant::default()));
    let mut guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    guard.hand_back = hand_back;
    let machine = Machine::parse(MACHINE, "m").expect("valid");
    let model = Model::new(&machine, guard.fading).expect("compiles");
    let paths = [true, false].map(|is_first| {
        let device = if is_first { "first" } else { "second" };
        let description = without_barrier(device, &[AxisName::X, AxisName::Y, AxisName::Z]);
        let plan = PathPlan::new(description.clone(), &model, &guard, &alone(), PERIOD);
        let way = Way {
            is_first,
            plant: Arc::clone(&plant),
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
    );
    let mut cycle = cycle.expect("two paths").with_clock(clock.clone());
    let mut seen = [false; 2];
    for number in 0..2500 {
        clock.advance(PERIOD);
        {
            let mut plant = plant.lock().expect("no panic");
            let travels = (begins..begins + 25).contains(&number);
            plant.x += if travels { 4.0 } else { 0.0 };
            plant.first_is_away = (800 + offset..1050 + offset).contains(&number);
        }
        let asked = Asked {
            request: (number == 5).then_some(Request::Arm),
            ..Asked::default()
        };
        cycle.run(clock.now(), &asked, &mut || Duration::ZERO);
        let report = cycle.report();
        seen[report.active] |= report.state == State::Compensating;
    }
    assert_eq!(seen, [true; 2], "both correct in their turn");
    plant.lock().expect("no panic").largest * 1e3
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
