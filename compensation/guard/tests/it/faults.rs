//! The guard's response to single faults.

use std::time::Duration;

use volcomp_guard::{
    Hold, Limits, Reasons, Request, State,
    barrier::{Barrier, Settings},
    protocol::Counts,
};
use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::world::{MACHINE, PERIOD, SECOND, STEP, World, axes, layout, limits};

#[test]
fn stale_positions_hold_then_ramp_out_then_back_in() {
    let mut world = World::compensating(&limits());
    let before = world.applied;
    world.frozen_at = Some(world.now);
    let held = world.run(Duration::from_millis(300));
    assert_eq!(held.state.name(), "holding");
    assert!(held.reasons.contains(Reasons::POSITIONS_STALE));
    assert_eq!(world.applied, before);
    let out = world.run(Duration::from_millis(300));
    assert_eq!(out.state.name(), "ramping-out");
    assert!(out.reasons.contains(Reasons::POSITIONS_LOST));
    assert!(world.applied[0] < before[0] && world.applied[0] > 0.0);
    let lost = world.run(SECOND);
    assert_eq!(lost.state.name(), "holding");
    assert_eq!(world.applied, PerChannel::ZERO);
    world.frozen_at = None;
    assert_eq!(world.run(Duration::from_millis(100)).state.name(), "arming");
    assert_eq!(world.run(SECOND).state, State::Compensating);
    assert_eq!(world.applied, before);
}

/// While the control does not respond, nothing is written. Then the output starts at the reported correction and ramps.
#[test]
fn after_a_reboot_it_ramps_from_the_applied_correction() {
    let mut world = World::compensating(&limits());
    world.answers = false;
    let silent = world.run(2 * SECOND);
    assert!(!silent.write);
    assert!(silent.reasons.contains(Reasons::NO_CONTROLLER));
    world.applied = PerChannel::ZERO;
    world.answers = true;
    // One reading does not confirm a correction; three separate readings do.
    let back = world.run(3 * PERIOD);
    assert!(!back.write && back.state.name() != "arming");
    let back = world.run(Duration::ZERO);
    assert_eq!(back.state.name(), "arming");
    assert!(world.applied[0].abs() <= STEP, "no step: {}", world.applied[0]);
    assert_eq!(world.run(2 * SECOND).state, State::Compensating);
    assert!((world.applied[0] - 0.040).abs() < 1e-9);
}

#[test]
fn lines_without_read_back_ramp_out_without_answers() {
    let mut world = World::lines(&limits());
    world.request(Request::Arm);
    world.run(SECOND);
    world.answers = false;
    world.run(2 * SECOND);
    assert_eq!(world.applied, PerChannel::ZERO);
}

/// The control clears the correction: nothing is sent while the reading may be older than the last write, then the correction ramps in
/// again.
#[test]
fn a_cleared_correction_ramps_in_again() {
    let mut world = World::compensating(&limits());
    world.applied = PerChannel::ZERO;
    let output = world.run(2 * PERIOD);
    assert!(!output.write, "it may be an old reading");
    let mut output = world.run(limits().zero_after);
    assert_eq!((output.state.name(), output.write), ("holding", false));
    assert!(output.reasons.contains(Reasons::UNCONFIRMED));
    world.largest_step = 0.0;
    for _ in 0..12 {
        output = world.run(Duration::ZERO);
    }
    assert_eq!(output.state.name(), "arming");
    assert!(world.largest_step <= STEP, "{}", world.largest_step);
    assert_eq!(world.run(2 * SECOND).state, State::Compensating);
    for _ in 0..5 {
        world.applied = PerChannel::ZERO;
        world.largest_step = 0.0;
        assert_eq!(world.run(3 * SECOND).state, State::Compensating);
        assert!(world.largest_step <= 0.002 + 1e-9, "{}", world.largest_step);
        assert!((world.applied[0] - 0.040).abs() < 1e-9);
    }
}

#[test]
fn a_write_that_does_not_stick_is_a_fault() {
    let mut world = World::compensating(&limits());
    world.sticks = false;
    world.target = Some(axes(0.080, -0.080));
    let output = world.run(2 * SECOND);
    assert_eq!(output.state.name(), "faulted");
    assert!(output.reasons.contains(Reasons::DOES_NOT_STICK));
    assert_eq!(world.request(Request::Acknowledge).state.name(), "faulted");
    world.sticks = true;
    world.run(2 * SECOND);
    assert_eq!(world.applied, PerChannel::ZERO);
    assert_eq!(world.request(Request::Arm).state.name(), "faulted");
    assert_eq!(world.request(Request::Acknowledge).state, State::Disarmed);
    assert_eq!(world.request(Request::Arm).state.name(), "arming");
    assert_eq!(world.run(2 * SECOND).state, State::Compensating);
}

#[test]
fn a_read_back_may_lag() {
    for (allowed, behind) in [(2, 1), (16, 12)] {
        let mut world = World::new(&Limits { read_back_cycles: allowed, ..limits() });
        let mut history = vec![PerChannel::ZERO; behind];
        world.request(Request::Arm);
        for cycle in 0..500 {
            let truth = world.applied;
            history.push(truth);
            world.applied = history[history.len() - 1 - behind];
            let output = world.run(Duration::ZERO);
            assert!(!output.reasons.contains(Reasons::READ_BACK), "cycle {cycle}");
            if !output.write {
                world.applied = truth;
            }
        }
        assert_eq!(world.guard.state(), State::Compensating);
    }
}

#[test]
fn interlocks_freeze_the_correction_and_it_ramps_in_again() {
    for interlock in 0..3 {
        let mut world = World::compensating(&limits());
        let set = |world: &mut World, on: bool| match interlock {
            0 => world.emergency_stop = on,
            1 => world.alarm = on,
            _ => world.referenced = !on,
        };
        set(&mut world, true);
        let output = world.run(SECOND);
        assert_eq!((output.state.name(), output.write), ("holding", false));
        world.applied = PerChannel::ZERO;
        world.answers = false;
        assert!(!world.run(SECOND).write);
        world.answers = true;
        set(&mut world, false);
        let output = world.run(4 * PERIOD);
        assert_eq!(output.state.name(), "arming");
        assert!(world.applied[0].abs() <= STEP);
        assert_eq!(world.run(2 * SECOND).state, State::Compensating);
    }
}

#[test]
fn nan_positions_hold_then_ramp_out() {
    let mut world = World::compensating(&limits());
    let before = world.applied;
    world.positions[1] = f64::NAN;
    let output = world.run(Duration::from_millis(300));
    assert_eq!(output.state.name(), "holding");
    assert!(output.reasons.contains(Reasons::NOT_A_NUMBER));
    assert_eq!(world.applied, before);
    world.run(2 * SECOND);
    assert_eq!(world.applied, PerChannel::ZERO);
    world.positions[1] = 0.0;
    world.applied[0] = f64::NAN;
    assert!(!world.run(SECOND).write);
}

#[test]
fn time_running_backwards_moves_nothing() {
    let mut world = World::compensating(&limits());
    world.target = Some(axes(0.0, 0.0));
    let before = world.applied;
    world.now -= Duration::from_millis(500);
    world.cycle_after(Duration::ZERO, None);
    assert_eq!(world.applied, before);
}

fn proving(includes: bool, really: bool) -> World {
    let mut limits = limits();
    limits.test_shift = PerChannel([5.0 * STEP; MAX_AXES]);
    for axis in &mut limits.axes {
        axis.includes_correction = includes;
    }
    let mut world = World::new(&limits);
    world.really_includes = really;
    world
}

#[test]
fn the_proof_waits_for_standstill() {
    let mut world = proving(false, false);
    world.request(Request::Arm);
    for _ in 0..500 {
        world.positions[0] += 0.01;
        let output = world.run(Duration::ZERO);
        assert!(output.reasons.contains(Reasons::WAITING_FOR_STANDSTILL));
        assert_eq!(world.applied, PerChannel::ZERO);
    }
    assert_eq!(world.run(4 * SECOND).state, State::Compensating);
}

/// A gateway is armed in a pause of a program that continues during the proof: the test shift is removed within a second, and the proof
/// completes in the next pause.
#[test]
fn a_continuing_program_is_not_left_with_the_test_shift() {
    for (includes, until) in [(false, 90), (true, 90), (false, 170), (true, 170)] {
        let mut world = proving(includes, includes);
        let goes_on = |world: &mut World, cycles: u32| {
            let mut shifted = 0;
            for cycle in 0..cycles {
                // Back and forth at 20 mm/s, then feeds at 0.2 mm/s.
                let rate = if cycle < cycles / 2 { 20.0 } else { 0.2 };
                let sign = if cycle % 100 < 50 { 1.0 } else { -1.0 };
                let way = sign * rate * PERIOD.as_secs_f64();
                (world.positions[0], world.positions[1]) =
                    (world.positions[0] + way, world.positions[1] + way);
                world.run(Duration::ZERO);
                shifted += u32::from(world.applied[0].abs() > 0.5 * STEP);
            }
            shifted
        };
        goes_on(&mut world, 100);
        world.request(Request::Arm);
        world.run(PERIOD * until);
        assert!(world.applied[0].abs() > 4.5 * STEP, "{:?}", world.applied);
        let shifted = goes_on(&mut world, 2000);
        assert!(PERIOD * shifted < SECOND, "{shifted}");
        let output = world.run_to(4 * SECOND, State::Compensating);
        assert!(!output.reasons.contains(Reasons::NOT_PROVEN));
    }
}

/// Frozen positions or an emergency stop during the proof end arming: the state is `disarmed`, no shift remains, and only a new request
/// arms.
#[test]
fn an_interrupted_proof_is_no_proof() {
    for really in [false, true] {
        let mut world = proving(false, really);
        world.request(Request::Arm);
        world.frozen_at = Some(world.now);
        let output = world.run(Duration::from_millis(400));
        assert_eq!(output.state.name(), "arming");
        world.run(2 * SECOND);
        assert_eq!(world.guard.state(), State::Disarmed);
        assert_eq!(world.applied, PerChannel::ZERO);
        world.frozen_at = None;
        assert_eq!(world.run(SECOND).state, State::Disarmed, "not without a request");
        world.request(Request::Arm);
        world.emergency_stop = true;
        world.run(SECOND);
        world.emergency_stop = false;
        assert_eq!(world.run(SECOND).state, State::Disarmed);
        assert_eq!(world.applied, PerChannel::ZERO);
        world.request(Request::Arm);
        let last = world.run(4 * SECOND).state.name();
        assert_eq!(last, if really { "faulted" } else { "compensating" });
    }
}

/// Failed writes, single or consecutive, do not change the state; the correction continues from the applied one without a step.
#[test]
fn lost_writes_are_no_event() {
    let mut world = World::compensating(&Limits { read_back_cycles: 1, ..limits() });
    let mut before = world.applied[0];
    for cycle in 0..2000 {
        world.target = Some(axes(0.05 * (f64::from(cycle) * 0.01).sin(), 0.0));
        world.sticks = cycle % 7 > 2;
        world.write_fails = !world.sticks;
        let output = world.run(Duration::ZERO);
        assert_eq!(output.state, State::Compensating, "cycle {cycle}");
        assert!((world.applied[0] - before).abs() <= 0.003 + 1e-9);
        before = world.applied[0];
    }
    assert!(before.abs() > 0.01);
}

/// The barrier accepts frames but does not move during a stop that no path reports: the state becomes `Holding(Unconfirmed)`, and the
/// correction continues after the stop.
#[test]
fn a_barrier_held_by_its_control_is_reported_and_continues() {
    let mut world = World::guarded(&limits()).arm();
    world.holds = true;
    // The axis has reached its goal, so the stop is not noticeable yet.
    let output = world.run(Duration::from_secs(1));
    assert_eq!(output.state, State::Compensating);
    world.target = Some(axes(0.140, -0.020));
    let output = world.run(limits().hold + limits().delay() + 6 * PERIOD);
    assert_eq!(output.state, State::Holding(Hold::Unconfirmed));
    assert!(output.reasons.contains(Reasons::UNCONFIRMED));
    let stood = world.run(Duration::from_secs(2));
    assert_eq!(stood.state, State::Holding(Hold::Unconfirmed));
    assert!((world.applied[0] - 0.040).abs() < 1e-9);
    world.holds = false;
    assert_eq!(world.run(Duration::from_secs(2)).state, State::Compensating);
    assert!((world.applied[0] - 0.140).abs() < 1e-9);
}

/// A correction of one count every 0.5 s does not count as held.
#[test]
fn a_slow_correction_is_not_reported_as_held() {
    let mut limits = limits();
    for axis in &mut limits.axes {
        axis.slew_per_s = 0.002;
    }
    let mut world = World::guarded(&limits);
    world.request(Request::Arm);
    for _ in 0..2000 {
        let output = world.run(Duration::ZERO);
        assert!(!output.reasons.contains(Reasons::UNCONFIRMED));
    }
    assert!(world.applied[0] > 0.01);
}

/// With 72 ms of delay both ways, the word has already changed when the acceptance of its frame is reported: this does
/// not count as a held control. A real hold is reported in time.
#[test]
fn a_slow_path_is_not_reported_as_a_held_control() {
    let scan_ms = Duration::from_millis;
    for (delay_ms, scan, step_scans) in [
        (0, scan_ms(2), 1),
        (20, scan_ms(2), 25),
        (40, scan_ms(8), 1),
        (70, scan_ms(2), 1),
        (80, scan_ms(8), 8),
        (110, scan_ms(1), 4),
        (150, scan_ms(2), 1),
        (150, scan_ms(10), 10),
    ] {
        // A cycle that permits configuring this delay.
        let period = Duration::from_millis(10);
        let cycles = delay_ms / 20;
        let limits = Limits {
            period,
            // Longer than the time until a frame is reported.
            hold: Duration::from_millis(50)
                .max(Duration::from_millis(u64::try_from(delay_ms + 30).expect("few"))),
            zero_after: Duration::from_secs(2),
            read_back_cycles: 2 * cycles + 2,
            ..limits()
        };
        let a_second = u16::try_from(1000 / scan.as_millis()).expect("few");
        let in_a_step = i16::try_from(scan.as_millis()).expect("few") * step_scans;
        let settings = Settings {
            axes: layout(),
            machine: MACHINE,
            limit: PerChannel([150; MAX_AXES]),
            rate: PerChannel([in_a_step; MAX_AXES]),
            step_scans: step_scans.unsigned_abs(),
            hold_scans: a_second / 2,
            time_out_scans: a_second,
        };
        let barrier = Barrier::start(settings, 17, 40, &Counts::default()).expect("valid");
        let mut world = World::guarded_by(&limits, barrier, scan);
        (world.frame_delay, world.report_delay) = (cycles, delay_ms / 10 - cycles);
        world.dates_reports = true;
        world.cycle_after(period, Some(Request::Arm));
        for cycle in 0..2600_u32 {
            // The correction creeps by one step every 20 to 300 ms, as for a slow rotary table or a machine that warms up.
            let sign = if (cycle / 100).is_multiple_of(2) { -1.0 } else { 1.0 };
            let creeps = sign * STEP / f64::from(2 + cycle / 100);
            world.target = world.target.map(|target| axes(target[0] + creeps, 0.010));
            let output = world.cycle_after(period, None);
            let unconfirmed = output.reasons.contains(Reasons::UNCONFIRMED);
            assert!(!unconfirmed, "{delay_ms} ms, {step_scans} of {scan:?}: cycle {cycle}");
        }
        (world.holds, world.target) = (true, Some(axes(0.0, 0.0)));
        let begun = world.now;
        while world.cycle_after(period, None).state == State::Compensating {
            assert!(world.now < begun + Duration::from_secs(2), "{delay_ms} ms: not reported");
        }
        let step = scan * u32::from(step_scans.unsigned_abs());
        let most = limits.hold + 2 * limits.delay() + step + 8 * period;
        assert!(world.now <= begun + most, "{delay_ms} ms: reported late");
    }
}

/// A path for thermal terms may hold for 5 s, longer than its barrier's timeout: once the barrier may have timed out, the state is not
/// `compensating`.
#[test]
fn a_barrier_that_may_have_timed_out_is_not_reported_as_compensating() {
    let limits = Limits {
        only_thermal: true,
        hold: Duration::from_secs(5),
        zero_after: Duration::from_secs(5),
        ..limits()
    };
    let faults: [fn(&mut World); 3] = [
        |world| world.answers = false,
        |world| world.hides_correction = true,
        |world| world.sticks = false,
    ];
    for fault in faults {
        let mut world = World::guarded(&limits).arm();
        fault(&mut world);
        for _ in 0..1000 {
            let stands = world.applied[0];
            let output = world.run(Duration::ZERO);
            // The barrier times out after 200 ms, and the report takes one cycle.
            let let_go = (stands - 0.040).abs() > 1e-9;
            let said = output.state == State::Compensating;
            assert!(!(let_go && said), "{:?} at {stands}", output.reasons);
        }
        assert_eq!(world.applied, PerChannel::ZERO);
        (world.answers, world.hides_correction, world.sticks) = (true, false, true);
        world.run_to(Duration::from_secs(3), State::Compensating);
    }
}
