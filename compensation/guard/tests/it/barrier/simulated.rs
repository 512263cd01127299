//! The reference barrier as the program of a simulated control.
//!
//! The tests check the motion of the axes under any fault of the wire, and the tip error of a five-axis correction
//! while the rotary axes move.

use std::{
    collections::VecDeque,
    sync::{Arc, atomic::Ordering},
    time::{Duration, Instant},
};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    AxisLimits, BarrierLink, CorrectionReport, Guard, Inputs, Limits, ReadBack, Reading, Reasons,
    Request, RequestedCorrection,
    barrier::{
        Barrier, FRAME_WORDS, Program, Protection, REPORT_WORDS, Report, Settings, SettingsError,
    },
    protocol::{Counts, Layout, Refusal, ReportStatus, Session},
    vocabulary::{AxisKind, AxisName, Displacement, Mm, PerChannel, Rad},
};
use volcomp_port::{
    Axis, Clock, ControlProgram, Controller, Words, contract,
    inject::{Faults, Faulty},
    simulated::{Controls, Machine, Move, SimulatedController},
};

use super::words;
use crate::vector::{five, of};

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

fn axes() -> Vec<Axis> {
    [AxisName::X, AxisName::Y, AxisName::C]
        .map(|name| Axis {
            name,
            includes_correction: false,
            resolution: match name {
                AxisName::C => Displacement::Angle(Rad(1e-5)),
                _ => Displacement::Length(Mm(0.001)),
            },
            largest: (name == AxisName::Y).then_some(Displacement::Length(Mm(0.1))),
        })
        .to_vec()
}

#[test]
fn physical_units_become_counts_and_scans() {
    let settings = Protection::default().settings(&axes()).expect("valid");
    assert_eq!(settings.axes.number(), 126);
    // 250 µm for X; the maximum value of the device for Y; 250 µrad in steps of 10 µrad for C.
    assert_eq!(settings.limit, PerChannel::leading([250, 100, 25]));
    // C: 1000 µrad/s is 0.2 counts per scan, thus one step in five scans. X and Y: 2 counts per scan.
    assert_eq!(settings.step_scans, 5);
    assert_eq!(settings.rate, PerChannel::leading([10, 10, 1]));
    assert_eq!((settings.hold_scans, settings.time_out_scans), (25, 100));
}

#[test]
fn invalid_protections_are_refused() {
    let cases: [fn(&mut Protection); 4] = [
        |protection| protection.rate_per_s = Mm(0.0),
        |protection| protection.rate_rotary_per_s = Rad(f64::NAN),
        |protection| protection.scan = Duration::ZERO,
        |protection| protection.time_out = Duration::from_millis(60),
    ];
    for change in cases {
        let mut protection = Protection::default();
        change(&mut protection);
        assert!(protection.settings(&axes()).is_err(), "{protection:?}");
    }
    let default = Protection::default();
    let below = Protection { limit: Mm(0.0005), ..default };
    assert_eq!(below.settings(&axes()), Err(SettingsError::Counts { axis: 0, found: 0 }));
    assert!(default.settings(&[]).is_err());
    assert!(default.settings(&axes().repeat(4)).is_err());
}

/// A restart increments the epoch and keeps the axes where they are; a frame from before the restart is rejected.
#[test]
fn a_restart_forgets_the_owner_and_keeps_epoch_and_axes() {
    let settings = Protection::default().settings(&axes()).expect("valid");
    let mut program = Program::new(settings).expect("valid");
    let decode = |words: &volcomp_port::Words| {
        Report::decode(settings.machine, settings.axes, words.as_slice()).expect("a whole report")
    };
    let mut session = Session::new(7);
    let goal = PerChannel::leading([30, -20, 3]);
    let mut mailbox = Vec::new();
    let mut report = decode(&program.scan(&[], false));
    for _ in 0..40 {
        assert!(matches!(session.read(report.head()), ReportStatus::Confirmed { .. }));
        mailbox = words(&settings, &session.frame(&goal).expect("a report was read"));
        report = decode(&program.scan(&[&mailbox], false));
    }
    assert_eq!((program.applied(), report.owner), (goal, 7));
    let held = program.applied();
    program.restart(&held);
    let after = decode(&program.scan(&[&mailbox], false));
    assert_eq!(after.epoch, report.epoch.wrapping_add(1));
    assert_eq!((after.owner, after.refusal), (0, Refusal::Epoch));
    assert_eq!(after.applied, goal);
    for _ in 0..settings.time_out_scans + 40 {
        program.scan(&[&mailbox], false);
    }
    assert_eq!(program.applied(), Counts::default());
}

const LEVER_MM: f64 = 300.0;

struct Case {
    linear_step: f64,
    rotary_step: f64,
    /// Delay from the guard to the barrier and back, cycles.
    delay: usize,
    /// Ratio of the barrier's rate to the guard's slew.
    rate: f64,
}

fn limits(case: &Case) -> Limits {
    let mut limits = five(0.0);
    for axis in limits.axes.iter_mut().take(5) {
        let rotary = axis.kind == AxisKind::Rotary;
        *axis = AxisLimits {
            limit: if rotary { 250e-6 } else { 0.250 },
            warn: f64::INFINITY,
            resolution: if rotary { case.rotary_step } else { case.linear_step },
            accel_per_s2: f64::INFINITY,
            includes_correction: false,
            ..*axis
        };
        axis.warn = axis.limit;
    }
    limits.hold = Duration::from_millis(100);
    limits.test_shift = PerChannel::ZERO;
    limits.read_back_cycles = 2 * case.delay + 2;
    limits
}

/// Largest tip error of the applied correction (mm) in cycles that the slew does not limit.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small whole numbers")]
fn off(case: &Case) -> f64 {
    let limits = limits(case);
    let layout = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::A, AxisName::C];
    let layout = Layout::of(layout).expect("each once");
    // The period of a scan is 2 ms.
    let in_a_scan =
        |i: usize| limits.axes[i].slew_per_s * case.rate * 0.002 / limits.axes[i].resolution;
    let step_scans = (0..5).map(|i| (1.0 / in_a_scan(i) - 1e-9).ceil()).fold(1.0, f64::max);
    let counts = |value: f64| (value - 1e-9).ceil() as i16;
    let of_axes = |value: &dyn Fn(usize) -> f64| {
        Counts::from_fn(|i| if i < 5 { counts(value(i)) } else { 0 })
    };
    let settings = Settings {
        axes: layout,
        machine: 1,
        limit: of_axes(&|i| limits.axes[i].limit / limits.axes[i].resolution),
        rate: of_axes(&|i| in_a_scan(i) * step_scans),
        step_scans: step_scans as u16,
        hold_scans: 50,
        time_out_scans: 150,
    };
    let mut barrier = Barrier::start(settings, 0, 0, &Counts::default()).expect("valid");
    let link = BarrierLink::new(7, 1, layout, Duration::from_millis(2));
    let mut way = ReadBack::barrier(link);
    let mut guard = Guard::new(limits).expect("valid");
    let (mut frames, mut reports) = (VecDeque::new(), VecDeque::new());
    let mut mailbox = [0; FRAME_WORDS];
    let (mut most, mut quiet) = (0.0_f64, 0);
    let mut requested = RequestedCorrection {
        rotary: of([0.0, 0.0, 0.0, 100e-6, -60e-6]),
        ..RequestedCorrection::default()
    };
    // The request moves Y and Z only to follow A and C.
    requested.follow[3] = of([0.0, LEVER_MM]);
    requested.follow[4] = of([0.0, 0.0, -0.7 * LEVER_MM]);
    for cycle in 0..1200_u32 {
        let now = Duration::from_millis(4) * (cycle + 1);
        if frames.len() > case.delay {
            mailbox = frames.pop_front().expect("some");
        }
        barrier.scan(&[&mailbox], false);
        let mut words = [0; REPORT_WORDS];
        let length = barrier.scan(&[&mailbox], false).encode(&mut words);
        reports.push_back((words, length, now));
        if reports.len() > case.delay {
            let (words, length, taken) = reports.pop_front().expect("some");
            way.receive(now, taken, &CorrectionReport::Barrier(&words[..length]), &limits);
        } else {
            way.receive(now, now, &CorrectionReport::Missing, &limits);
        }
        let out = guard.cycle(&Inputs {
            now,
            reading: Some(Reading { taken: now, positions: PerChannel::ZERO }),
            read_back: *way.status(),
            requested: Some(requested),
            request: (cycle == 450).then_some(Request::Arm),
            ..Inputs::default()
        });
        if out.write {
            let mut frame = [0; FRAME_WORDS];
            if way.frame(&out.correction, &limits, &mut frame).is_some() {
                frames.push_back(frame);
            }
            way.sent(now, &out.correction, true);
        } else if let Some(last) = frames.back() {
            frames.push_back(*last);
        }
        let slews = out.reasons.contains(Reasons::SLEWING);
        quiet = if slews { 0 } else { quiet + 1 };
        if quiet > 2 * case.delay {
            let at = |i: usize| f64::from(barrier.memory().applied[i]) * limits.axes[i].resolution;
            let y = at(1) - LEVER_MM * at(3);
            let z = at(2) + 0.7 * LEVER_MM * at(4);
            most = most.max(y.abs()).max(z.abs());
        }
    }
    assert_eq!(guard.state(), volcomp_guard::State::Compensating);
    most
}

/// For any delay and rate the tip error is at most 1.1 linear steps plus one rotary step at its lever, because the barrier rounds to the
/// nearest count. Rounding towards the start of the line would add up to one linear step.
#[test]
fn a_barrier_adds_half_a_count_to_the_tip_error() {
    for delay in [0, 2, 4, 8] {
        for rate in [2.0, 10.0] {
            for (linear_step, rotary_step) in
                [(1e-3, 1e-6), (1e-4, 1e-7), (1e-4, 1e-6), (1e-3, 1e-7)]
            {
                let case = Case { linear_step, rotary_step, delay, rate };
                let off = off(&case);
                let most = 1.1 * linear_step + rotary_step * LEVER_MM;
                assert!(
                    off <= most,
                    "{off} of {most}: {delay} cycles, steps {linear_step} {rotary_step}"
                );
            }
        }
    }
}
