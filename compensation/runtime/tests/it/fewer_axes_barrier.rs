//! Three axes behind a barrier, and a second way that writes two of them: it takes over when nothing is left on the third.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_model::Machine;
use volcomp_port::{Clock, Controller, Description, Fault, Snapshot, Words};
use volcomp_runtime::{
    Asked, AxisSettings, BarrierSettings, ControlPath, Cycle, GuardSettings, Model, PathPlan,
    PathSettings, Sensors,
    guard::{
        ControlTimeOut, Request, State,
        barrier::{Barrier, Counts, Layout, REPORT_WORDS, Settings},
    },
};
use volcomp_vocabulary::{AxisName, MAX_AXES, PerChannel, Um};

use crate::rig::{PERIOD, alone, referenced, without_barrier};

/// Z needs 120 µm.
const MACHINE: &str = "structure = \"w X' Y' b Z t\"
axes = { X.travel = [0, 100], Y.travel = [0, 500], Z.travel = [0, 400] }
errors = { EZZ = -120 }";
const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];
const SCAN: Duration = Duration::from_millis(2);

/// The control: its barrier, its mailbox, and what it shows.
struct Plant {
    barrier: Barrier,
    mailbox: Option<Vec<u16>>,
    first_is_away: bool,
    stop: bool,
}

struct Way {
    plant: Arc<Mutex<Plant>>,
    clock: Clock,
    description: Description,
}

impl Controller for Way {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _: Instant) -> Result<Snapshot, Fault> {
        let plant = self.plant.lock().expect("no panic");
        let mut snapshot = referenced(PerChannel::leading([10.0]), self.clock.now(), None);
        if !self.description.barrier {
            snapshot.state.emergency_stop = plant.stop;
            return Ok(snapshot);
        }
        if plant.first_is_away {
            return Err(Fault::TimedOut);
        }
        let mut words = [0; REPORT_WORDS];
        let length = plant.barrier.report().encode(&mut words);
        snapshot.report = Words::new(&words[..length]);
        Ok(snapshot)
    }

    fn post(&mut self, frame: &Words, _: Instant) -> Result<(), Fault> {
        let mut plant = self.plant.lock().expect("no panic");
        if plant.first_is_away {
            return Err(Fault::TimedOut);
        }
        plant.mailbox = Some(frame.as_slice().to_vec());
        Ok(())
    }

    fn apply(&mut self, _: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        Ok(())
    }
}

fn way(first: bool, plant: &Arc<Mutex<Plant>>, clock: &Clock, model: &Model) -> ControlPath {
    let guard = guard();
    let axes = if first { &AXES[..] } else { &AXES[..2] };
    let description = Description {
        barrier: first,
        tells_applied: first,
        reads: (AXES.iter().filter(|name| !axes.contains(name)).copied()).collect(),
        ..without_barrier("control", axes)
    };
    let settings = PathSettings {
        barrier: first.then_some(BarrierSettings {
            machine: 1,
            scan: SCAN,
        }),
        // The way of X and Y goes to zero by itself, too.
        time_out: (!first).then_some(ControlTimeOut {
            after: Duration::from_millis(200),
            to_zero: Duration::from_millis(100),
        }),
        proves: false,
        ..alone()
    };
    let plan = PathPlan::new(description.clone(), model, &guard, &settings, PERIOD).expect("fits");
    let way = Way {
        plant: Arc::clone(plant),
        clock: clock.clone(),
        description,
    };
    ControlPath::new(Box::new(way), &plan).expect("fits")
}

fn guard() -> GuardSettings {
    let mut guard = GuardSettings::new(AxisSettings::new(Um(150.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    guard.zero_after = Duration::from_secs(3);
    guard
}

/// The most that Z has, counts, while the second way writes, and whether it did. The first one is cut off from cycle 1500 on;
/// an emergency stop, which the second shows, lasts until cycle `stop_until`.
fn left_on_z(real_scan: Duration, time_out_scans: u16, stop_until: i32) -> (i16, bool) {
    let settings = Settings {
        axes: Layout::of(AXES).expect("each once"),
        machine: 1,
        limit: PerChannel([150; MAX_AXES]),
        rate: PerChannel([2; MAX_AXES]),
        step_scans: 1,
        hold_scans: 25,
        time_out_scans,
    };
    let plant = Arc::new(Mutex::new(Plant {
        barrier: Barrier::start(settings, 1, 0, &Counts::default()).expect("good settings"),
        mailbox: None,
        first_is_away: false,
        stop: false,
    }));
    let clock = Clock::manual();
    let machine = Machine::parse(MACHINE, "m").expect("valid");
    let guard = guard();
    let model = Model::new(&machine, guard.fading).expect("compiles");
    let ways = [true, false].map(|first| way(first, &plant, &clock, &model));
    let sensors = Sensors::new(Vec::new(), guard.temperatures);
    let cycle = Cycle::new(
        Box::new(model),
        ways.into(),
        guard.hand_back,
        sensors,
        PERIOD,
    );
    let mut cycle = cycle.expect("fits").with_clock(clock.clone());
    let mut scanned = Duration::ZERO;
    let (mut most, mut taken_over) = (0, false);
    for number in 0..4000 {
        clock.advance(PERIOD);
        let mut control = plant.lock().expect("no panic");
        control.first_is_away = number >= 1500;
        control.stop = (1500..stop_until).contains(&number);
        while scanned + real_scan <= clock.elapsed() {
            scanned += real_scan;
            let (mailbox, stop) = (control.mailbox.clone(), control.stop);
            let mailboxes: Vec<&[u16]> = mailbox.as_deref().into_iter().collect();
            control.barrier.scan(&mailboxes, stop);
        }
        drop(control);
        let asked = Asked {
            request: (number == 700).then_some(Request::Arm),
            ..Asked::default()
        };
        cycle.run(clock.now(), &asked, &mut || Duration::ZERO);
        let report = cycle.report();
        assert!(number != 1499 || report.state == State::Compensating);
        if report.active == 1 {
            taken_over = true;
            most = most.max(plant.lock().expect("no panic").barrier.memory().applied[2]);
        }
    }
    (most, taken_over)
}

/// A control whose scans are longer than configured, and yet accepted, had 120 µm on Z when the second way took over.
#[test]
fn a_slow_control_is_at_zero_when_fewer_axes_take_over() {
    let found = left_on_z(Duration::from_micros(2450), 1000, 0);
    assert_eq!(found, (0, true));
}

/// A barrier holds in a stop; the time until it is taken for zero ran on, and 112 µm were left on Z.
#[test]
fn a_stop_does_not_count_until_fewer_axes_take_over() {
    assert_eq!(left_on_z(SCAN, 100, 2500), (0, true));
}
