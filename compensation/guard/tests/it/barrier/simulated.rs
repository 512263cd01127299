//! The reference barrier in the control of a simulated machine: what the axes get, whatever comes over the wire.

use std::{
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use volcomp_guard::{
    barrier::{Counts, FRAME_WORDS, Program, Protection, Report, Seen, Session, Settings},
    vocabulary::{AxisName, Displacement, Mm, PerChannel},
};
use volcomp_port::{
    Axis, Clock, Controller, Words, contract,
    simulated::{Controls, Machine, Move, SimulatedController},
};

const SCAN: Duration = Duration::from_millis(2);

fn soon() -> Instant {
    Instant::now() + Duration::from_secs(1)
}

fn start(clock: Clock) -> (SimulatedController, Settings, Arc<Controls>) {
    let axes = [AxisName::X, AxisName::Y].map(|name| Axis {
        name,
        includes_correction: true,
        resolution: Displacement::Length(Mm(0.001)),
        largest: None,
    });
    let settings = Protection::default().settings(&axes).expect("sensible");
    let program = Program::new(settings).expect("sensible");
    let machine = Machine {
        axes: axes.to_vec(),
        program: vec![Move {
            to: PerChannel::leading([100.0]),
            feed_per_s: 10.0,
            dwell: Duration::from_secs(1),
        }],
        acceleration_per_s2: 1000.0,
        sensors: Vec::new(),
        truth: Arc::new(|_, _| PerChannel::ZERO),
        clock,
    };
    let (controller, _, controls) = machine.start_with(Box::new(program), SCAN);
    (controller, settings, controls)
}

/// A sender that wants a goal, and sends it in every cycle.
struct Sender {
    session: Session,
    settings: Settings,
}

impl Sender {
    fn cycle(&mut self, controller: &mut SimulatedController, goal: &Counts) -> Option<Seen> {
        let report = controller.read(soon()).expect("it reads").report?;
        let report = Report::decode(self.settings.machine, self.settings.axes, report.as_slice())
            .expect("whole");
        let seen = self.session.read(&report);
        if let Some(frame) = self.session.frame(goal) {
            let mut words = [0; FRAME_WORDS];
            let length = frame.encode(&self.settings, &mut words);
            let words = Words::new(&words[..length]).expect("fewer than a block has");
            controller.post(&words, soon()).expect("it takes frames");
        }
        Some(seen)
    }
}

#[test]
fn the_contract_holds_with_the_reference_barrier() {
    contract::controller(&mut start(Clock::system()).0);
}

#[test]
fn the_axes_go_at_the_barriers_rate_stop_with_the_machine_and_go_to_zero_without_a_sender() {
    let clock = Clock::manual();
    let (mut controller, settings, controls) = start(clock.clone());
    let mut sender = Sender {
        session: Session::new(77),
        settings,
    };
    let goal = PerChannel::leading([150, -40]);
    let period = Duration::from_millis(4);
    for cycle in 0..200 {
        clock.advance(period);
        // A stop in the middle of the way.
        let stopped = (20..60).contains(&cycle);
        controls.emergency_stop.store(stopped, Ordering::Relaxed);
        sender.cycle(&mut controller, &goal);
        if cycle == 59 {
            assert!((0.02..0.149).contains(&controls.axes.applied()[0]));
        }
    }
    assert_eq!(controls.axes.applied()[..2], [0.150, -0.040]);
    assert_eq!(controls.axes.changes_while_held(), 0);
    let rate = f64::from(settings.rate[0]) * 0.001;
    let changes = controls.axes.largest_change();
    assert!(
        changes[..2].iter().all(|change| *change <= rate + 1e-12),
        "{changes:?}"
    );
    // Another gateway is told who holds the machine.
    let mut second = controller.another().expect("few ways");
    let mut other = Sender {
        session: Session::new(78),
        settings,
    };
    clock.advance(period);
    let seen = other.cycle(&mut second, &PerChannel::leading([-150, 40]));
    assert_eq!(seen, Some(Seen::Held { owner: 77 }));
    // The gateway dies: within the time-out and the way the axes are at zero, and they never step.
    let plant = controller.plant();
    drop(controller);
    let way = Duration::from_secs_f64(0.150 / 1.0);
    clock.advance(Duration::from_millis(200) + way + SCAN * 2);
    assert_eq!(plant.applied()[..2], [0.0, 0.0]);
    assert!(controls.axes.largest_change()[0] <= rate + 1e-12);
}
