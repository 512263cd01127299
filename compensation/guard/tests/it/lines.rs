//! Lines whose device reports their levels, which then count as applied instead of the last write; and lines without
//! reports.

use core::time::Duration;

use volcomp_guard::{ControlTimeOut, CorrectionReport, ReadBack, Reasons, Request, State};
use volcomp_vocabulary::PerChannel;

use crate::world::{PERIOD, SECOND, World, axes, limits, same_places};

/// Slew per cycle, with rounding, mm.
const MOST: f64 = 0.002 * (1.0 + 1e-9);
const TIME_OUT: ControlTimeOut =
    ControlTimeOut { after: Duration::from_millis(200), to_zero: Duration::from_millis(300) };
const UNKNOWN: Reasons = Reasons::LEFT_UNKNOWN;

/// Lines with reported levels and this applied correction of X, mm.
fn reporting(x: f64) -> World {
    let mut world = World::lines(&limits());
    world.reports_levels = true;
    world.applied = axes(x, 0.0);
    world
}

fn armed() -> World {
    let mut world = reporting(0.0);
    world.run(SECOND);
    let world = world.arm();
    world.assert_applied(axes(0.040, -0.020), "armed");
    world
}

/// Restores a stored correction of X, mm, of this age; NaN is unknown.
fn restore(world: &mut World, x: f64, age: Duration) {
    let values = if x.is_nan() { axes(x, x) } else { axes(x, 0.0) };
    world.read_back.restore(world.now, &values, age, &limits());
    world.largest_step = 0.0;
}

/// Arms; within two seconds the guard must compensate without a step.
#[track_caller]
fn arms(world: &mut World, case: &str) {
    world.request(Request::Arm);
    world.run_to(2 * SECOND, State::Compensating);
    world.assert_steps(MOST, case);
}

fn confirmed(world: &World) -> Option<PerChannel<f64>> {
    world.status().confirmed.map(|confirmed| confirmed.values)
}

/// A module without power for 1 s reports outputs of 0: the stored 40 µm are not shown as applied, and the correction ramps in.
#[test]
fn lines_that_were_off_ramp_in_from_their_levels() {
    let mut world = armed();
    (world.answers, world.write_fails) = (false, true);
    world.applied = PerChannel::ZERO;
    let reasons = world.run(SECOND).reasons;
    assert!(reasons.contains(Reasons::UNCONFIRMED | UNKNOWN), "{reasons:?}");
    (world.answers, world.write_fails) = (true, false);
    world.largest_step = 0.0;
    world.run_to(3 * SECOND, State::Compensating);
    world.assert_steps(MOST, "on again");
    assert!((world.applied[0] - 0.040).abs() < 1e-9);
}

/// A module accepts but ignores writes for 45 ms: the slew of that time is not written in one step afterwards.
#[test]
fn delayed_writes_do_not_accumulate() {
    let mut world = armed();
    world.target = Some(axes(-0.040, 0.020));
    world.run(5 * PERIOD);
    world.sticks = false;
    world.run(10 * PERIOD);
    world.sticks = true;
    world.run_to(2 * SECOND, State::Compensating);
    world.assert_steps(MOST, "delayed");
    assert!((world.applied[0] + 0.040).abs() < 1e-9);
}

/// Levels are reported some cycles late and the request reverses at any time: no step.
#[test]
fn late_levels_make_no_step() {
    for late in 0..3 {
        let mut world = armed();
        world.report_delay = late;
        for turn in 0..60_u32 {
            let sign = if turn % 2 == 0 { 1.0 } else { -1.0 };
            world.target = Some(axes(0.040 * sign, -0.020 * sign));
            world.run(PERIOD * (turn % 23));
        }
        world.run_to(2 * SECOND, State::Compensating);
        world.assert_steps(MOST, &format!("{late} cycles late"));
        assert!((world.applied[0] + 0.040).abs() < 1e-9, "{late}");
    }
}

/// A device without inputs loses its positions: readable lines still ramp to zero as long as they accept writes.
#[test]
fn readable_lines_ramp_out_when_positions_are_lost() {
    let mut world = armed();
    world.answers = false;
    world.run(2 * SECOND);
    assert_eq!(world.applied, PerChannel::ZERO);
    world.assert_steps(MOST, "without positions");
}

/// Without a stored correction, lines with reported levels start there; other lines need the operator's check.
#[test]
fn an_unknown_stored_correction_is_not_zero() {
    for reports in [true, false] {
        let mut world = reporting(-0.030);
        world.reports_levels = reports;
        world.target = Some(axes(-0.030, 0.0));
        restore(&mut world, f64::NAN, Duration::ZERO);
        let reasons = world.run(10 * PERIOD).reasons;
        assert_eq!(reasons.contains(UNKNOWN), !reports, "{reasons:?}");
        if reports {
            arms(&mut world, "reported");
        } else {
            world.request(Request::Arm);
            world.run_to(2 * SECOND, State::Disarmed);
            world.assert_steps(MOST, "unknown");
        }
    }
}

/// With an unknown correction a disarmed guard writes nothing until an acknowledgement.
#[test]
fn disarming_does_not_ramp_out_an_unknown_correction() {
    let mut world = World::lines(&limits());
    restore(&mut world, f64::NAN, Duration::ZERO);
    for request in [Request::Disarm, Request::End] {
        world.request(request);
        let output = world.run_to(SECOND, State::Disarmed);
        assert!(output.reasons.contains(UNKNOWN) && !output.write);
    }
    world.request(Request::Acknowledge);
    arms(&mut world, "acknowledged");
}

/// Lines that take over start at their present levels, which are left from an earlier outage of the other path.
#[test]
fn lines_that_take_over_start_at_their_levels() {
    let mut world = reporting(0.020);
    world.run(10 * PERIOD);
    world.read_back.take_over(world.now, false);
    world.largest_step = 0.0;
    arms(&mut world, "taken over");
}

#[test]
fn left_levels_are_reported_and_disarming_ramps_them_out() {
    let mut world = World::lines(&limits());
    restore(&mut world, f64::NAN, 10 * SECOND);
    world.reports_levels = true;
    world.applied = axes(0.020, -0.010);
    let output = world.run_to(10 * PERIOD, State::Disarmed);
    assert!(output.reasons.contains(Reasons::CORRECTION_LEFT));
    world.largest_step = 0.0;
    world.request(Request::Disarm);
    world.run_to(3 * SECOND, State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
    world.assert_steps(MOST, "disarmed");
}

/// The control ramps to zero at its timeout while its lines keep their levels. These levels count only while the lines
/// are written, and arming makes no step.
#[test]
fn levels_of_a_control_that_times_out_count_only_while_it_is_written() {
    let mut world = reporting(0.040);
    world.read_back = ReadBack::no_read_back(Some(TIME_OUT));
    world.report_delay = 1;
    restore(&mut world, 0.0, 10 * SECOND);
    world.run(10 * PERIOD);
    let x = |world: &World| confirmed(world).map(|values| values[0]);
    assert_eq!(x(&world), Some(0.0), "the timeout has passed");
    let first = world.request(Request::Arm).correction[0].abs();
    assert!(first <= MOST, "{first}");
    world.run(PERIOD);
    world.largest_step = 0.0;
    world.run_to(2 * SECOND, State::Compensating);
    world.assert_steps(MOST, "armed");
    // Writes fail for a second, so the control goes to zero.
    (world.answers, world.write_fails) = (false, true);
    let reasons = world.run(Duration::from_millis(350)).reasons;
    assert!(reasons.contains(UNKNOWN), "{reasons:?}");
    world.run(SECOND);
    (world.answers, world.write_fails) = (true, false);
    world.run(PERIOD);
    let begins = x(&world).expect("at zero").abs();
    assert!(begins <= 3.0 * MOST, "{begins}");
    world.run_to(3 * SECOND, State::Compensating);
}

/// A stored correction counts as applied until the control starts to ramp to zero, is unknown during the ramp, and is
/// zero afterwards.
#[test]
fn a_stored_correction_counts_until_the_control_times_out() {
    let stored = Some(0.040);
    for (age_ms, expected) in
        [(0, stored), (199, stored), (200, None), (500, None), (501, Some(0.0))]
    {
        let mut world = World::lines(&limits());
        world.read_back = ReadBack::no_read_back(Some(TIME_OUT));
        restore(&mut world, 0.040, Duration::from_millis(age_ms));
        let x = confirmed(&world).map(|values| values[0]);
        assert_eq!(x, expected, "{age_ms} ms");
    }
}

/// Lines without read-back that take over again start at their last write, because the control keeps its correction.
#[test]
fn lines_that_take_over_again_start_at_their_last_write() {
    let mut world = World::lines(&limits()).arm();
    world.request(Request::Disarm);
    world.run(10 * PERIOD);
    let left = world.applied[0];
    assert!(left > 0.01, "{left}");
    let places = same_places();
    world.guard.take_path(limits(), &places).expect("valid");
    world.read_back.take_over(world.now, false);
    world.run(10 * PERIOD);
    world.largest_step = 0.0;
    world.request(Request::TakeOver);
    world.run_to(2 * SECOND, State::Compensating);
    world.assert_steps(MOST, "taken over");
    // A barrier also drops a correction that was written on lines.
    world.read_back.take_over(world.now, true);
    assert_eq!(confirmed(&world), Some(PerChannel::ZERO));
}

/// The stored correction may have been written by another path. Unless it is zero, the applied correction is unknown,
/// and the operator must check it.
#[test]
fn lines_that_take_over_do_not_guess_the_correction_of_the_previous_run() {
    for (stored, acknowledged, is_known) in [
        (0.0, false, true),
        (0.020, false, false),
        (0.020, true, true),
        (f64::NAN, false, false),
        (f64::NAN, true, true),
    ] {
        let mut world = World::lines(&limits());
        let (now, values) = (world.now, axes(stored, 0.0));
        world.read_back.restore(now, &values, Duration::ZERO, &limits());
        if acknowledged {
            world.read_back.acknowledge(now);
        }
        world.read_back.take_over(now, false);
        let reasons = world.run(PERIOD).reasons;
        assert_eq!(reasons.contains(UNKNOWN), !is_known, "{stored}: {reasons:?}");
        world.request(Request::Acknowledge);
        world.request(Request::Arm);
        world.run_to(2 * SECOND, State::Compensating);
    }
}

/// The correction of a control with a timeout is the last output until the timeout can have expired, unknown while the
/// ramp may run, and then zero.
#[test]
fn a_control_that_times_out_is_known_by_the_time_since_the_last_write() {
    for waited_ms in [0, 100, 190, 210, 300, 490, 510, 2000] {
        let waited = Duration::from_millis(waited_ms);
        let written = axes(0.030, 0.0);
        let mut world = World::lines(&limits());
        world.read_back = ReadBack::no_read_back(Some(TIME_OUT));
        world.run(PERIOD);
        let (sent, now) = (world.now, world.now + waited);
        world.read_back.sent(sent, &written, true);
        let read = |world: &mut World| {
            let missing = CorrectionReport::Missing;
            world.read_back.receive(now, now, &missing, &limits());
            (confirmed(world), world.status().control_acts_at)
        };
        read(&mut world);
        let before = read(&mut world);
        world.read_back.take_over(now, false);
        assert_eq!(read(&mut world), before, "{waited_ms} ms");
        let expected = if waited + PERIOD < TIME_OUT.after {
            Some(written)
        } else if waited <= TIME_OUT.after + TIME_OUT.to_zero {
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
    world.run_to(SECOND, State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
    world.write_fails = false;
    world.run(60 * SECOND);
    world.request(Request::Acknowledge);
    world.run(SECOND);
    arms(&mut world, "accepted");
}
