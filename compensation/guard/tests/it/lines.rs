//! Lines whose device tells what its outputs carry: that is what is applied, not what was written.

use core::time::Duration;

use volcomp_guard::{ControlTimeOut, CorrectionReport, ReadBack, Reasons, Request, State};
use volcomp_vocabulary::PerChannel;

use crate::world::{PERIOD, STEP, World, axes, limits, same_places};

const SECOND: Duration = Duration::from_secs(1);

/// The largest change of an axis by one write: one slew or one step, and the rounding of numbers.
fn allowed() -> f64 {
    (limits().axes[0].slew_per_s * PERIOD.as_secs_f64()).max(STEP) * (1.0 + 1e-9)
}

/// Lines that are told, with a correction on them.
fn told() -> World {
    let mut world = World::lines(&limits());
    world.tells_levels = true;
    world.run(SECOND);
    let world = world.arm();
    assert!((world.applied[0] - 0.040).abs() < 1e-9);
    world
}

/// A module without power for 1 s reports outputs at 0: the stored 40 µm used to be written in one step, and shown as applied meanwhile.
#[test]
fn lines_that_were_off_ramp_in_from_their_levels() {
    let mut world = told();
    (world.answers, world.write_fails) = (false, true);
    world.applied = PerChannel::ZERO;
    let out = world.run(SECOND);
    assert!(
        out.reasons
            .contains(Reasons::UNCONFIRMED | Reasons::LEFT_UNKNOWN),
        "{:?}",
        out.reasons
    );
    (world.answers, world.write_fails) = (true, false);
    world.largest_step = 0.0;
    let out = world.run(3 * SECOND);
    assert!(world.largest_step <= allowed(), "{} mm", world.largest_step);
    assert_eq!(out.state, State::Compensating, "{:?}", out.reasons);
    assert!((world.applied[0] - 0.040).abs() < 1e-9);
}

/// A module ignores accepted writes for 45 ms: 18 µm of slew used to be written in one step afterwards.
#[test]
fn delayed_writes_do_not_accumulate() {
    let mut world = told();
    world.target = Some(axes(-0.040, 0.020));
    world.run(5 * PERIOD);
    world.sticks = false;
    world.run(10 * PERIOD);
    world.sticks = true;
    let out = world.run(2 * SECOND);
    assert!(world.largest_step <= allowed(), "{} mm", world.largest_step);
    assert_eq!(out.state, State::Compensating, "{:?}", out.reasons);
    assert!((world.applied[0] + 0.040).abs() < 1e-9);
}

/// Levels are reported some cycles late, and the request reverses at any time.
#[test]
fn late_levels_make_no_step() {
    for late in 0..3 {
        let mut world = told();
        world.told_late = late;
        for turn in 0..60_u32 {
            let sign = if turn % 2 == 0 { 1.0 } else { -1.0 };
            world.target = Some(axes(0.040 * sign, -0.020 * sign));
            world.run(PERIOD * (turn % 23));
        }
        let out = world.run(2 * SECOND);
        assert!(
            world.largest_step <= allowed(),
            "{late}: {} mm",
            world.largest_step
        );
        assert_eq!(out.state, State::Compensating, "{:?}", out.reasons);
        assert!((world.applied[0] + 0.040).abs() < 1e-9, "{late}");
    }
}

/// A device without inputs is still written to zero, as far as it accepts writes.
#[test]
fn readable_lines_ramp_out_when_positions_are_lost() {
    let mut world = told();
    world.answers = false;
    world.run(2 * SECOND);
    assert_eq!(world.applied, PerChannel::ZERO);
    assert!(world.largest_step <= allowed(), "{} mm", world.largest_step);
}

/// Nothing is stored: with reported levels the output starts there, without them the operator must check. It used to count as zero and was written in
/// one step.
#[test]
fn an_unknown_stored_correction_is_not_zero() {
    for tells in [true, false] {
        let mut world = World::lines(&limits());
        world.applied = axes(-0.030, 0.0);
        world.target = Some(axes(-0.030, 0.0));
        world.tells_levels = tells;
        let none = PerChannel::from_fn(|_| f64::NAN);
        world
            .read_back
            .restore(world.now, &none, Duration::ZERO, &limits());
        world.largest_step = 0.0;
        let out = world.run(10 * PERIOD);
        let unknown = Reasons::LEFT_UNKNOWN;
        assert_eq!(out.reasons.contains(unknown), !tells, "{:?}", out.reasons);
        world.request(Request::Arm);
        let out = world.run(2 * SECOND);
        assert!(
            world.largest_step <= allowed(),
            "{tells}: {} mm",
            world.largest_step
        );
        let expected = if tells {
            State::Compensating
        } else {
            State::Disarmed
        };
        assert_eq!(out.state, expected, "{:?}", out.reasons);
    }
}

/// The state used to be "ramping-out" until an acknowledgement.
#[test]
fn disarming_does_not_ramp_out_an_unknown_correction() {
    let mut world = World::lines(&limits());
    let none = PerChannel::from_fn(|_| f64::NAN);
    let now = world.now;
    world
        .read_back
        .restore(now, &none, Duration::ZERO, &limits());
    for request in [Request::Disarm, Request::End] {
        world.request(request);
        let out = world.run(SECOND);
        assert!(out.reasons.contains(Reasons::LEFT_UNKNOWN));
        assert_eq!((out.state, out.write), (State::Disarmed, false));
    }
    world.request(Request::Acknowledge);
    world.request(Request::Arm);
    assert_eq!(world.run(2 * SECOND).state, State::Compensating);
}

/// Lines kept the levels of an earlier outage of the other path, and used to start at zero.
#[test]
fn lines_that_take_over_start_at_their_levels() {
    let mut world = World::lines(&limits());
    world.tells_levels = true;
    world.applied = axes(0.020, 0.0);
    world.run(10 * PERIOD);
    world.read_back.take_over(world.now, false);
    world.largest_step = 0.0;
    world.request(Request::Arm);
    assert_eq!(world.run(2 * SECOND).state, State::Compensating);
    assert!(world.largest_step <= allowed(), "{} mm", world.largest_step);
}

/// The origin of the levels is unknown.
#[test]
fn left_levels_are_reported_and_disarming_ramps_them_out() {
    let mut world = World::lines(&limits());
    let unknown = axes(f64::NAN, f64::NAN);
    world
        .read_back
        .restore(world.now, &unknown, 10 * SECOND, &limits());
    world.tells_levels = true;
    world.applied = axes(0.020, -0.010);
    let out = world.run(10 * PERIOD);
    assert_eq!(out.state, State::Disarmed);
    assert!(out.reasons.contains(Reasons::CORRECTION_LEFT));
    world.largest_step = 0.0;
    world.request(Request::Disarm);
    let out = world.run(3 * SECOND);
    assert_eq!(out.state, State::Disarmed, "{:?}", out.reasons);
    assert_eq!(world.applied, PerChannel::ZERO);
    assert!(world.largest_step <= allowed(), "{} mm", world.largest_step);
}

/// A control that goes to zero on its own does so while its lines keep their levels.
#[test]
fn levels_of_a_control_that_times_out_count_only_while_it_is_written() {
    let mut world = World::lines(&limits());
    world.read_back = ReadBack::no_read_back(Some(ControlTimeOut {
        after: Duration::from_millis(200),
        to_zero: Duration::from_millis(300),
    }));
    world.tells_levels = true;
    world.told_late = 1;
    world.applied = axes(0.040, 0.0);
    let (now, zero) = (world.now, PerChannel::ZERO);
    world.read_back.restore(now, &zero, 10 * SECOND, &limits());
    world.run(10 * PERIOD);
    let known = |world: &World| world.known().confirmed.map(|confirmed| confirmed.values[0]);
    assert_eq!(known(&world), Some(0.0), "it had the time to let go");
    let first = world.request(Request::Arm);
    assert!(
        first.correction[0].abs() <= allowed(),
        "{}",
        first.correction[0]
    );
    world.run(PERIOD);
    world.largest_step = 0.0;
    let out = world.run(2 * SECOND);
    assert_eq!(out.state, State::Compensating, "{:?}", out.reasons);
    assert!(world.largest_step <= allowed(), "{} mm", world.largest_step);
    // Nothing is taken for a second: the control is at zero by itself.
    (world.answers, world.write_fails) = (false, true);
    let out = world.run(Duration::from_millis(350));
    assert!(
        out.reasons.contains(Reasons::LEFT_UNKNOWN),
        "{:?}",
        out.reasons
    );
    world.run(SECOND);
    (world.answers, world.write_fails) = (true, false);
    world.run(PERIOD);
    let begins = known(&world).expect("let go");
    assert!(begins.abs() <= 3.0 * allowed(), "{begins}");
    assert_eq!(world.run(3 * SECOND).state, State::Compensating);
}

/// Lines without read-back used to start at zero whenever they took over, although the control keeps its correction.
#[test]
fn lines_that_take_over_again_start_at_their_last_write() {
    let mut world = World::lines(&limits()).arm();
    world.request(Request::Disarm);
    world.run(10 * PERIOD);
    let left = world.applied[0];
    assert!(left > 0.01, "{left}");
    // Another path writes meanwhile.
    world
        .guard
        .take_path(limits(), &same_places())
        .expect("good limits");
    world.read_back.take_over(world.now, false);
    world.run(10 * PERIOD);
    world.largest_step = 0.0;
    world.request(Request::TakeOver);
    assert_eq!(world.run(2 * SECOND).state, State::Compensating);
    assert!(world.largest_step <= allowed(), "{} mm", world.largest_step);
    // A barrier has let go of what came on lines, too.
    world.read_back.take_over(world.now, true);
    let known = world.known().confirmed.map(|confirmed| confirmed.values);
    assert_eq!(known, Some(PerChannel::ZERO));
}

/// The stored correction may have been written by another path: unless it is zero, the operator must check.
#[test]
fn lines_that_take_over_do_not_guess_the_correction_of_the_previous_run() {
    for (remembered, looked_at, known) in [
        (0.0, false, true),
        (0.020, false, false),
        (0.020, true, true),
        (f64::NAN, false, false),
        (f64::NAN, true, true),
    ] {
        let mut world = World::lines(&limits());
        let (now, values) = (world.now, axes(remembered, 0.0));
        world
            .read_back
            .restore(now, &values, Duration::ZERO, &limits());
        if looked_at {
            world.read_back.acknowledge(now);
        }
        world.read_back.take_over(now, false);
        let out = world.run(PERIOD);
        let unknown = out.reasons.contains(Reasons::LEFT_UNKNOWN);
        assert_eq!(unknown, !known, "{remembered}: {:?}", out.reasons);
        world.request(Request::Acknowledge);
        world.request(Request::Arm);
        assert_eq!(world.run(2 * SECOND).state, State::Compensating);
    }
}

/// The last output while it cannot have acted, unknown while it may be ramping, then zero.
#[test]
fn a_control_that_times_out_is_known_by_the_time_since_the_last_write() {
    let (after, to_zero) = (Duration::from_millis(200), Duration::from_millis(300));
    for waited_ms in [0, 100, 190, 210, 300, 490, 510, 2000] {
        let mut world = World::lines(&limits());
        world.read_back = ReadBack::no_read_back(Some(ControlTimeOut { after, to_zero }));
        let waited = Duration::from_millis(waited_ms);
        let written = axes(0.030, 0.0);
        world.run(PERIOD);
        let sent = world.now;
        world.read_back.sent(sent, &written, true);
        let now = sent + waited;
        let mut hear = || {
            world
                .read_back
                .receive(now, now, &CorrectionReport::Missing, &limits());
            let known = world.read_back.status();
            (
                known.confirmed.map(|confirmed| confirmed.values),
                known.control_acts_at,
            )
        };
        hear();
        let before = hear();
        world.read_back.take_over(now, false);
        let mut hear = || {
            world
                .read_back
                .receive(now, now, &CorrectionReport::Missing, &limits());
            let known = world.read_back.status();
            (
                known.confirmed.map(|confirmed| confirmed.values),
                known.control_acts_at,
            )
        };
        assert_eq!(hear(), before, "{waited_ms} ms");
        let expected = if waited + PERIOD < after {
            Some(written)
        } else if waited <= after + to_zero {
            None
        } else {
            Some(PerChannel::ZERO)
        };
        assert_eq!(before.0, expected, "{waited_ms} ms");
    }
}

#[test]
fn lines_that_rejected_writes_can_be_armed_once_they_accept_them() {
    let mut world = World::lines(&limits());
    world.write_fails = true;
    world.request(Request::Arm);
    world.run(Duration::from_millis(200));
    world.request(Request::Disarm);
    let out = world.run(Duration::from_secs(1));
    assert_eq!(
        (out.state, world.applied),
        (State::Disarmed, PerChannel::ZERO)
    );
    world.write_fails = false;
    world.run(Duration::from_secs(60));
    world.request(Request::Acknowledge);
    world.run(Duration::from_secs(1));
    world.request(Request::Arm);
    let out = world.run(Duration::from_secs(2));
    assert_eq!(out.state, State::Compensating, "{:?}", out.reasons);
}
