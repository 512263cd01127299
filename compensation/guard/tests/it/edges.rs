//! What made an axis step at the edges of an earlier guard: what is read back, when a write lands, what is remembered.
//! Frozen positions and axes that are not proven are looked at in `proof`, rolling over in `direction`, sensors that jump in
//! `temperature`. Each case is looked at on the axis, with a barrier in the control and without one where that makes a difference.

use std::{f64::consts::TAU, time::Duration};

use volcomp_guard::{Cause, Limits, Reasons, Request, State};
use volcomp_vocabulary::PerChannel;

use crate::world::{PERIOD, World, axes, barrier_from, limits};

const SECOND: Duration = Duration::from_secs(1);
/// What the guard slews in a cycle, and the barrier in a scan, with a rounding, mm.
const MOST: f64 = 0.002 + 1e-9;

/// Read back as closely as a control can be.
fn close() -> Limits {
    Limits {
        read_back_cycles: 1,
        ..limits()
    }
}

/// A control without a barrier that can be asked, and one with a barrier.
fn asked(limits: &Limits) -> Vec<World> {
    vec![World::new(limits), World::guarded(limits)]
}

/// The same two and lines, which cannot be asked.
fn all(limits: &Limits) -> Vec<World> {
    vec![
        World::new(limits),
        World::guarded(limits),
        World::lines(limits),
    ]
}

fn scheme(world: &World) -> volcomp_guard::Scheme {
    world.known().scheme
}

/// 40 µm were stored; the control had gone to zero and reported it. The first write used to move the axis by 40 µm.
#[test]
fn the_control_overrides_the_stored_correction() {
    for mut world in asked(&close()) {
        let remembered = axes(0.040, 0.0);
        let limits = *world.guard.limits();
        let (now, age) = (world.now, Duration::ZERO);
        world.read_back.restore(now, &remembered, age, &limits);
        let shown = world.run(SECOND);
        assert_eq!(shown.correction, PerChannel::ZERO, "{:?}", scheme(&world));
        let mut world = world.arm_from_here();
        assert_eq!(world.run(2 * SECOND).state, State::Compensating);
        assert!(world.largest_step <= MOST, "{}", world.largest_step);
    }
}

/// A reading off by 256 µm used to move the axis by that much; one of −65.536 mm was written back. Also wrong: another axis's values, NaN.
#[test]
fn one_wrong_reading_moves_nothing() {
    for lie in [
        axes(0.040 + 0.256, -0.020),
        axes(-65.536, -0.020),
        axes(-0.020, 0.040),
        axes(f64::NAN, -0.020),
        axes(0.0, 0.0),
    ] {
        let mut world = World::compensating(&close());
        for _ in 0..20 {
            world.lie = Some(lie);
            world.run(Duration::ZERO);
            world.lie = None;
            let output = world.run(Duration::ZERO);
            assert!(!output.reasons.contains(Reasons::READ_BACK), "{lie:?}");
            world.run(SECOND / 10);
        }
        assert_eq!(world.applied, axes(0.040, -0.020), "{lie:?}");
        assert!(world.largest_step <= 1e-12, "{lie:?}");
        assert_eq!(world.guard.state(), State::Compensating);
    }
}

/// With a barrier, the checksum detects any wrong word of a report.
#[test]
fn one_wrong_word_of_a_report_moves_nothing() {
    let mut world = World::guarded(&close()).arm();
    for word in 0..volcomp_guard::barrier::REPORT_WORDS {
        for bits in [1, 0x0100, 0x8000, 0xffff] {
            world.spoils_word = Some((word, bits));
            world.run(Duration::ZERO);
            world.spoils_word = None;
            let output = world.run(Duration::ZERO);
            assert_eq!(output.state, State::Compensating, "word {word}, {bits:x}");
        }
    }
    assert!(world.largest_step <= 1e-12, "{}", world.largest_step);
    assert_eq!(world.applied, axes(0.040, -0.020));
}

/// Readings 96 ms old on a path with 60 ms used to count as foreign corrections, and the axis stepped back to them; readings 160 ms old happened to
/// be equal three times. With a barrier, frames that answer a late report are rejected for their tick.
#[test]
fn a_read_back_older_than_allowed_makes_no_step() {
    for late in [16, 24, 40, 100, 130] {
        for mut world in asked(&Limits {
            read_back_cycles: 15,
            ..limits()
        }) {
            world.told_late = late;
            world.run(SECOND);
            world.target = Some(axes(0.150, 0.0));
            let mut world = world.arm_from_here();
            for cycle in 0..2000_u32 {
                let requested = 0.1 * (TAU * f64::from(cycle) * 0.001).sin();
                world.target = Some(axes(0.050 + requested, 0.0));
                world.run(Duration::ZERO);
                assert!(world.applied[0].abs() <= 0.150 + 1e-9);
            }
            let kind = scheme(&world);
            assert!(
                world.largest_step <= MOST,
                "{kind:?}, {late} cycles late: {} mm",
                world.largest_step
            );
        }
    }
}

/// The control refused every write for 10 s; the state used to stay `arming` with 40 µm shown as applied.
#[test]
fn refused_writes_are_a_fault_and_nothing_is_shown_as_applied() {
    for mut world in all(&close()) {
        (world.sticks, world.write_fails) = (false, true);
        world.request(Request::Arm);
        let mut faulted = None;
        for cycle in 0..2500 {
            let output = world.run(Duration::ZERO);
            if output.state.name() == "faulted" {
                faulted.get_or_insert(cycle);
            }
        }
        let kind = scheme(&world);
        // After `zero_after_ms`, 500 ms.
        assert!(
            faulted.is_some_and(|cycle| cycle < 300),
            "{kind:?}: {faulted:?}"
        );
        assert_eq!(world.guard.output(), PerChannel::ZERO, "{kind:?}");
        assert_eq!(world.applied, PerChannel::ZERO, "{kind:?}");
    }
}

/// Y rejects its words while X follows a moving machine: this used to stay unreported for a minute. Each row is the request for Y, and the motion of
/// X.
#[test]
fn one_axis_that_rejects_every_write_is_a_fault() {
    for (y, x_um, hz) in [
        (0.005, 50.0, 0.1),
        (0.010, 50.0, 0.2),
        (0.020, 100.0, 0.2),
        (0.040, 100.0, 0.4),
        (0.040, 100.0, 0.5),
        (0.002, 20.0, 0.05),
    ] {
        let mut world = World::new(&close());
        world.request(Request::Arm);
        let mut faulted = None;
        for cycle in 0..15_000_u32 {
            let at_s = f64::from(cycle) * 0.004;
            world.target = Some(axes(x_um * 1e-3 * (TAU * hz * at_s).sin(), y));
            let output = world.run(Duration::ZERO);
            // Y is deaf.
            world.applied[1] = 0.0;
            assert!(world.largest_step <= MOST, "{}", world.largest_step);
            if output.state.name() == "faulted" {
                faulted = Some(at_s);
                break;
            }
        }
        // It is faulted as soon as Y has been asked for a step three times.
        assert!(
            faulted.is_some_and(|after| after < 5.0),
            "Y wants {y} mm, X ±{x_um} µm at {hz} Hz: {faulted:?}"
        );
    }
}

/// Lines that could not be written kept their levels while the guard ramped to zero: once restored, the axis used to move from 40 µm to 0 in one
/// write.
#[test]
fn restored_lines_make_no_step() {
    for arms_again in [false, true] {
        let mut world = World::lines(&limits()).arm();
        let held = world.applied;
        (world.answers, world.sticks, world.write_fails) = (false, false, true);
        world.run(Duration::from_millis(1200));
        assert_eq!(world.guard.output(), held, "what the lines carry is known");
        (world.answers, world.sticks, world.write_fails) = (true, true, false);
        if arms_again {
            world.run(2 * SECOND);
            world.request(Request::Acknowledge);
            world.request(Request::Arm);
        }
        world.run(3 * SECOND);
        assert!(world.largest_step <= MOST, "{}", world.largest_step);
        let (x, state) = (world.applied[0], world.guard.state());
        assert!(x.abs() < 1e-9 || (x - held[0]).abs() < 1e-9, "{x}");
        assert!(!arms_again || state == State::Compensating, "{state:?}");
    }
}

/// A reading lost during an emergency stop on the ramp out used to lift the stop, and lines were written.
#[test]
fn a_lost_reading_does_not_lift_an_emergency_stop() {
    for world in all(&limits()) {
        let mut world = world.arm();
        world.request(Request::Disarm);
        world.run(Duration::from_millis(100));
        world.emergency_stop = true;
        world.run(Duration::from_millis(20));
        let held = world.applied;
        assert!(held[0].abs() > 0.010, "it is on its way: {held:?}");
        for lost in [PERIOD, Duration::from_millis(200), 5 * SECOND] {
            world.answers = false;
            world.run(lost);
            world.answers = true;
            world.run(SECOND / 10);
            let kind = scheme(&world);
            assert_eq!(world.applied, held, "{kind:?}: moved in the stop");
        }
        world.emergency_stop = false;
        world.largest_step = 0.0;
        assert_eq!(world.run(2 * SECOND).state, State::Disarmed);
        assert_eq!(world.applied, PerChannel::ZERO);
        assert!(world.largest_step <= MOST, "{}", world.largest_step);
    }
}

/// The read-back is NaN for 5 s.
#[test]
fn a_nan_read_back_is_not_reported_as_compensating() {
    for world in asked(&limits()) {
        let mut world = world.arm();
        world.target = Some(axes(-0.080, 0.0));
        for _ in 0..1250 {
            world.lie = Some(axes(f64::NAN, f64::NAN));
            world.spoils_word = Some((3, 0xffff));
            let output = world.run(Duration::ZERO);
            assert!(world.barrier.is_some() || !output.write);
        }
        let state = world.guard.state();
        assert_ne!(state, State::Compensating, "{:?}", scheme(&world));
        assert!(world.largest_step <= MOST, "{}", world.largest_step);
        (world.lie, world.spoils_word) = (None, None);
        world.run(3 * SECOND);
        assert!(world.largest_step <= MOST, "{}", world.largest_step);
    }
}

/// The control was cleared while its report was late: the guard used to write the previous 40 µm in one step.
#[test]
fn a_correction_cleared_without_a_report_ramps_in_again() {
    for silent in [1, 3, 12, 100] {
        let mut world = World::compensating(&limits());
        let requested = world.applied;
        world.hides_applied = true;
        world.clear(PerChannel::ZERO);
        for _ in 0..silent {
            world.run(Duration::ZERO);
            assert!(world.applied[0].abs() <= MOST, "{:?}", world.applied);
        }
        world.hides_applied = false;
        world.run(3 * SECOND);
        assert!(world.largest_step <= MOST, "{}", world.largest_step);
        assert_eq!(world.applied, requested, "silent for {silent} cycles");
    }
}

/// Only the control's own start clears a correction behind a barrier. Without reports nothing is sent: it ramps out after its timeout, and in again
/// with the next report.
#[test]
fn a_barrier_without_frames_ramps_out() {
    for silent in [1, 3, 12, 100, 500] {
        let mut world = World::guarded(&limits()).arm();
        let requested = world.applied;
        world.hides_applied = true;
        for _ in 0..silent {
            world.run(Duration::ZERO);
        }
        // Hold, time-out and the way are 50 ms + 200 ms + 20 ms.
        assert!(silent < 70 || world.applied == PerChannel::ZERO);
        world.hides_applied = false;
        world.run(3 * SECOND);
        assert!(world.largest_step <= MOST, "{}", world.largest_step);
        assert_eq!(world.applied, requested, "silent for {silent} cycles");
    }
}

/// The program was stopped for 2 s between reading and writing while the control was cleared: the late write used to move the axis by 40 µm.
#[test]
fn an_expired_decision_is_not_sent() {
    for world in asked(&limits()) {
        let mut world = world.arm();
        world.target = Some(axes(0.100, 0.0));
        world.largest_step = 0.0;
        let (_, sent) = world.freezes_between(PERIOD, 2 * SECOND, None);
        assert!(!sent, "{:?}", scheme(&world));
        world.clear(PerChannel::ZERO);
        world.run(3 * SECOND);
        assert!(world.largest_step <= MOST, "{}", world.largest_step);
        assert!((world.applied[0] - 0.100).abs() < 1e-9);
    }
}

/// Two readings repeated a write of 32 ms before, as a late path may: the axis used to step from 25 to 20 µm. A value once confirmed to be replaced
/// is not applied any more.
#[test]
fn readings_that_repeat_an_earlier_write_make_no_step() {
    for repeated in 1..12 {
        for back in 1..=8 {
            let mut world = World::new(&Limits {
                read_back_cycles: 8,
                ..limits()
            })
            .arm_from_here();
            let mut past = Vec::new();
            while world.applied[0] < 0.025 {
                world.run(Duration::ZERO);
                past.push(world.applied);
            }
            for _ in 0..repeated {
                world.lie = Some(past[past.len() - 1 - back]);
                world.run(Duration::ZERO);
            }
            world.lie = None;
            world.run(2 * SECOND);
            assert!(world.largest_step <= MOST, "{}", world.largest_step);
            assert_eq!(world.guard.state(), State::Compensating);
            assert_eq!(world.applied, axes(0.040, -0.020));
        }
    }
}

/// With late readings and lost writes, any write since the last confirmed one may be applied; the next one must be close to all of them.
#[test]
fn a_lost_write_before_a_late_reading_makes_no_step() {
    for pattern in 0..64_u32 {
        let mut world = World::new(&Limits {
            read_back_cycles: 8,
            ..limits()
        })
        .arm();
        world.told_late = 7;
        for cycle in 0..2000_u32 {
            let requested = 0.040 + 0.004 * (TAU * f64::from(cycle) * 0.02).sin();
            world.target = Some(axes(requested, -0.020));
            world.sticks = pattern >> (cycle / 3 % 6) & 1 == 0;
            world.run(Duration::ZERO);
        }
        assert!(
            world.largest_step <= MOST,
            "pattern {pattern:b}: {}",
            world.largest_step
        );
    }
}

/// In another fault, three false readings of 1.5 mm used to be written to the axis, and 1.5 mm that were found were ramped out without the operator.
#[test]
fn a_correction_beyond_the_limit_needs_acknowledgement_in_any_fault() {
    let faulted = || {
        let mut world = World::new(&close()).arm();
        (world.sticks, world.target) = (false, Some(axes(0.080, -0.080)));
        world.run(SECOND);
        assert_eq!(world.guard.state(), State::Faulted(Cause::DoesNotStick));
        world.sticks = true;
        world.run(2 * SECOND);
        assert_eq!(world.applied, PerChannel::ZERO);
        world.largest_step = 0.0;
        world
    };
    // Readings that lie: nothing moves.
    let mut world = faulted();
    for _ in 0..300 {
        world.lie = Some(axes(1.5, 0.0));
        assert!(!world.run(Duration::ZERO).write || world.largest_step == 0.0);
    }
    assert!(world.largest_step <= MOST, "{}", world.largest_step);
    // And what is really found stays until a person has looked.
    let mut world = faulted();
    world.clear(axes(1.5, 0.0));
    world.run(2 * SECOND);
    assert_eq!(world.guard.state(), State::Faulted(Cause::BeyondLimit));
    assert_eq!(world.applied, axes(1.5, 0.0), "nothing is written");
    world.request(Request::Acknowledge);
    world.run(5 * SECOND);
    assert_eq!(world.guard.state(), State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
    assert!(world.largest_step <= MOST, "{}", world.largest_step);
}

/// A reading dated 10 s ahead used to keep its positions fresh.
#[test]
fn a_reading_from_the_future_counts_as_present() {
    let mut world = World::compensating(&limits());
    world.frozen_at = Some(world.now + 10 * SECOND);
    world.run(Duration::ZERO);
    world.frozen_at = Some(world.now);
    let output = world.run(SECOND / 5);
    assert_eq!(output.state.name(), "holding");
    assert!(output.reasons.contains(Reasons::POSITIONS_STALE));
}

/// A wrong message repeated with each new position used to count as three readings.
#[test]
fn one_repeated_message_is_one_reading() {
    let mut limits = limits();
    limits.read_back_cycles = 15;
    let mut world = World::new(&limits);
    // A message may be told for as long as the path may be behind.
    for _ in 0..15 {
        world.lie = Some(axes(-0.020, 0.0));
        world.run(Duration::ZERO);
    }
    world.lie = None;
    let mut world = world.arm_from_here();
    world.run(2 * SECOND);
    assert!(world.largest_step <= MOST, "{}", world.largest_step);
}

/// The barrier accepts frames, but the control holds the axis.
#[test]
fn an_axis_that_does_not_follow_is_reported() {
    let mut world = World::guarded(&close()).arm();
    world.target = Some(axes(0.140, 0.0));
    let barrier = world.barrier;
    let mut told = 0;
    for _ in 0..100 {
        // Its tick and sequence go on; what is applied does not.
        if let (Some(now), Some(before)) = (&mut world.barrier, &barrier) {
            let memory = volcomp_guard::barrier::Memory {
                applied: before.memory().applied,
                from: before.memory().applied,
                ..now.memory()
            };
            let settings = now.report().settings;
            *now = volcomp_guard::barrier::Barrier::resume(settings, memory).expect("good");
        }
        let output = world.run(Duration::ZERO);
        told += usize::from(output.reasons.contains(Reasons::SLEWING));
    }
    assert!(told > 20, "told in {told} of 100 cycles");
}

/// The scans are counted anew after a restart of the control: for a second the barrier used to be reported as unfit.
#[test]
fn a_restarted_control_still_fits() {
    for tick in [0, 40, 30_000, 65_000] {
        let mut world = World::guarded(&limits()).arm();
        world.answers = false;
        world.run(SECOND / 2);
        world.barrier = Some(barrier_from(1000, tick));
        world.mailbox.clear();
        world.answers = true;
        for _ in 0..1000 {
            let output = world.run(Duration::ZERO);
            for unfit in [Reasons::BARRIER_UNFIT, Reasons::WATCHING] {
                assert!(!output.reasons.contains(unfit), "{:?}", output.reasons);
            }
        }
        assert_eq!(world.guard.state(), State::Compensating);
        assert!((world.applied[0] - 0.040).abs() < 1e-9);
    }
}

/// With repeated short outages the barrier had gone to zero each time, a fault; after the acknowledgement earlier failures still counted, and arming
/// faulted at once.
#[test]
fn arming_works_after_an_acknowledged_fault() {
    let mut faults = 0;
    for silent in [50, 100, 190, 250, 300, 460] {
        for mut world in asked(&limits()).into_iter().map(World::arm) {
            for _ in 0..20 {
                world.answers = false;
                world.run(Duration::from_millis(silent));
                world.answers = true;
                world.run(Duration::from_millis(10));
            }
            world.run(SECOND);
            if world.guard.state() == State::Faulted(Cause::DoesNotStick) {
                faults += 1;
                world.request(Request::Acknowledge);
                world.run(SECOND);
                assert_eq!(world.guard.state(), State::Disarmed, "{silent} ms");
                world.request(Request::Arm);
            }
            let output = world.run(2 * SECOND);
            assert_eq!(output.state, State::Compensating, "{silent} ms");
            assert!((world.applied[0] - 0.040).abs() < 1e-9);
            assert!(world.largest_step <= MOST, "{}", world.largest_step);
        }
    }
    assert!(faults > 0, "it was never a fault");
}
