//! The reference barrier in the control of a simulated machine: motion of the axes under any fault of the wire.

use std::{
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    barrier::{FRAME_WORDS, Program, Protection, Report, Settings},
    protocol::{Counts, ReportStatus, Session},
    vocabulary::{AxisName, Displacement, Mm, PerChannel},
};
use volcomp_port::{
    Axis, Clock, Controller, Words, contract,
    inject::{Faults, Faulty},
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
    let settings = Protection::default().settings(&axes).expect("valid");
    let program = Program::new(settings).expect("valid");
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

/// A sender that sends its goal in every cycle.
struct Sender {
    session: Session,
    settings: Settings,
}

impl Sender {
    fn cycle(&mut self, controller: &mut impl Controller, goal: &Counts) -> Option<ReportStatus> {
        let report = controller.read(soon()).ok()?.report?;
        let report = Report::decode(self.settings.machine, self.settings.axes, report.as_slice())?;
        let seen = self.session.read(report.head());
        if let Some(frame) = self.session.frame(goal) {
            let mut words = [0; FRAME_WORDS];
            let length = frame.encode(&self.settings, &mut words);
            let words = Words::new(&words[..length]).expect("fewer than a block has");
            // The next reports show whether the frame arrived.
            let _ = controller.post(&words, soon());
        }
        Some(seen)
    }
}

#[test]
fn the_reference_barrier_fulfils_the_contract() {
    contract::controller(&mut start(Clock::system()).0);
}

#[test]
fn the_axes_follow_the_barriers_rate_hold_during_stops_and_go_to_zero_without_a_sender() {
    let clock = Clock::manual();
    let (mut controller, settings, controls) = start(clock.clone());
    let mut sender = Sender { session: Session::new(77), settings };
    let goal = PerChannel::leading([150, -40]);
    let period = Duration::from_millis(4);
    for cycle in 0..200 {
        clock.advance(period);
        // A machine stop in the middle of the motion.
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
    assert!(changes[..2].iter().all(|change| *change <= rate + 1e-12), "{changes:?}");
    // Another gateway finds the owner in the report.
    let mut second = controller.another().expect("few ways");
    let mut other = Sender { session: Session::new(78), settings };
    clock.advance(period);
    let seen = other.cycle(&mut second, &PerChannel::leading([-150, 40]));
    assert_eq!(seen, Some(ReportStatus::Held { owner: 77 }));
    // The gateway stops: within timeout and ramp the axes are at zero, without a step.
    let plant = controller.plant();
    drop(controller);
    let way = Duration::from_secs_f64(0.150 / 1.0);
    clock.advance(Duration::from_millis(200) + way + SCAN * 2);
    assert_eq!(plant.applied()[..2], [0.0, 0.0]);
    assert!(controls.axes.largest_change()[0] <= rate + 1e-12);
}

/// All fault injectors in random order, two gateways on separate paths, machine stops and restarts of the control: no axis exceeds the
/// barrier's rate or limit, or moves during an emergency stop.
#[test]
fn no_fault_of_the_wire_makes_an_axis_step() {
    let period = Duration::from_millis(4);
    let (mut taken, mut furthest) = (0, 0.0_f64);
    for seed in 0..400_u64 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let clock = Clock::manual();
        let (controller, settings, controls) = start(clock.clone());
        let second = controller.another().expect("few ways");
        let mut chance = || {
            if rng.random_bool(0.5) { [0.002, 0.02, 0.1][rng.random_range(0..3)] } else { 0.0 }
        };
        let faults = Faults {
            drop: chance(),
            freeze: chance(),
            disconnect: 0.1 * chance(),
            calls: 60,
            lie: chance(),
            constant: chance(),
            late_write: chance(),
            double_write: chance(),
            torn_write: chance(),
            reordered_write: chance(),
            late_answer: chance(),
            stop_after_read: 0.1 * chance(),
            stop_before_write: 0.1 * chance(),
            stop: Duration::from_millis(800),
            dropped_flag: chance(),
            ..Faults::default()
        };
        let mut ways = [controller, second]
            .map(|way| Faulty::new(way, faults, seed).with_clock(clock.clone()));
        let mut senders = [rng.random(), rng.random()]
            .map(|owner| Sender { session: Session::new(owner), settings });
        let mut goals = [PerChannel::leading([0, 0]); 2];
        for _ in 0..600 {
            clock.advance(period);
            if rng.random_bool(0.01) {
                let stopped = rng.random_bool(0.3);
                controls.emergency_stop.store(stopped, Ordering::Relaxed);
            }
            if rng.random_bool(0.002) {
                controls.restart.store(true, Ordering::Relaxed);
            }
            for (index, (sender, way)) in senders.iter_mut().zip(&mut ways).enumerate() {
                if rng.random_bool(0.003) {
                    sender.session = Session::new(rng.random());
                }
                if rng.random_bool(0.02) {
                    // Goals may exceed the limit, which no guard requests.
                    let mut some = || rng.random_range(-300..=300);
                    goals[index] = PerChannel::leading([some(), some()]);
                }
                sender.cycle(way, &goals[index]);
            }
        }
        ways[0].device.plant().pass();
        let log = &controls.axes;
        for axis in 0..2 {
            let rate = f64::from(settings.rate[axis]) * 0.001;
            let limit = f64::from(settings.limit[axis]) * 0.001;
            assert!(log.largest_change()[axis] <= rate + 1e-12, "seed {seed}");
            assert!(log.furthest()[axis] <= limit + 1e-12, "seed {seed}");
            furthest = furthest.max(log.furthest()[axis]);
        }
        assert_eq!(log.changes_while_held(), 0, "seed {seed}");
        taken += log.scans();
    }
    assert!(taken > 400_000 && furthest > 0.1, "{taken} scans, {furthest} mm");
}
