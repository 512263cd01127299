//! Faults at the interfaces of the guard: read-back, late writes, and stored corrections.
//!
//! A read-back may arrive in separate messages. Each test checks the motion of the axes with and without a barrier.

use std::{f64::consts::TAU, time::Duration};

use volcomp_guard::{
    BarrierMisfit, Cause, ControlTimeOut, CorrectionReport, Limits, ReadBack, ReadBackStatus,
    Reasons, Request, Scheme, State,
    barrier::{Barrier, Memory, REPORT_WORDS},
};
use volcomp_vocabulary::PerChannel;

use crate::world::{MOST, PERIOD, SCAN, SECOND, STEP, World, axes, barrier_from, limits};

const COMPENSATING: State = State::Compensating;
const DOES_NOT_STICK: State = State::Faulted(Cause::DoesNotStick);

fn with_delay(read_back_cycles: usize) -> Limits {
    Limits { read_back_cycles, ..limits() }
}

/// Controls with read-back, without and with a barrier.
fn readable(limits: &Limits) -> Vec<World> {
    vec![World::new(limits), World::guarded(limits)]
}

/// The controls of [`readable`], and a control with lines.
fn all(limits: &Limits) -> Vec<World> {
    let mut worlds = readable(limits);
    worlds.push(World::lines(limits));
    worlds
}

fn scheme(world: &World) -> Scheme {
    world.status().scheme
}

/// The stored correction is 40 µm, but the control is at zero and reports 0: the first write makes no step.
#[test]
fn the_control_overrides_the_stored_correction() {
    for mut world in readable(&with_delay(1)) {
        let limits = *world.guard.limits();
        let (now, stored) = (world.now, axes(0.040, 0.0));
        world.read_back.restore(now, &stored, Duration::ZERO, &limits);
        let shown = world.run(SECOND);
        assert_eq!(shown.correction, PerChannel::ZERO, "{:?}", scheme(&world));
        let mut world = world.arm_from_here();
        world.run_to(2 * SECOND, COMPENSATING);
        world.assert_steps(MOST, "armed");
    }
}

/// A single reading that is wrong by 256 µm, is −65.536 mm or NaN, or has another axis's values moves no axis.
#[test]
fn one_wrong_reading_moves_nothing() {
    for reading in [
        axes(0.040 + 0.256, -0.020),
        axes(-65.536, -0.020),
        axes(-0.020, 0.040),
        axes(f64::NAN, -0.020),
        axes(0.0, 0.0),
    ] {
        let mut world = World::compensating(&with_delay(1));
        for _ in 0..20 {
            world.false_reading = Some(reading);
            world.run(Duration::ZERO);
            world.false_reading = None;
            let output = world.run(Duration::ZERO);
            assert!(!output.reasons.contains(Reasons::READ_BACK), "{reading:?}");
            world.run(SECOND / 10);
        }
        assert_eq!(world.applied, axes(0.040, -0.020), "{reading:?}");
        world.assert_steps(1e-12, "wrong reading");
        assert_eq!(world.guard.state(), COMPENSATING);
    }
}

#[test]
fn one_wrong_word_of_a_report_moves_nothing() {
    let mut world = World::guarded(&with_delay(1)).arm();
    for word in 0..REPORT_WORDS {
        for bits in [1, 0x0100, 0x8000, 0xffff] {
            world.flipped_word = Some((word, bits));
            world.run(Duration::ZERO);
            world.flipped_word = None;
            world.run_to(Duration::ZERO, COMPENSATING);
        }
    }
    world.assert_steps(1e-12, "wrong words");
    assert_eq!(world.applied, axes(0.040, -0.020));
}

/// Readings older than the path permits, even a reading repeated three times, are not taken for a foreign correction,
/// so no axis steps. A barrier rejects frames that answer a late report.
#[test]
fn a_read_back_older_than_allowed_makes_no_step() {
    for late in [16, 24, 40, 100, 130] {
        for mut world in readable(&with_delay(15)) {
            world.report_delay = late;
            world.run(SECOND);
            world.target = Some(axes(0.150, 0.0));
            let mut world = world.arm_from_here();
            for cycle in 0..2000_u32 {
                let wave = 0.1 * (TAU * f64::from(cycle) * 0.001).sin();
                world.target = Some(axes(0.050 + wave, 0.0));
                world.run(Duration::ZERO);
                assert!(world.applied[0].abs() <= 0.150 + 1e-9);
            }
            world.assert_steps(MOST, &format!("{:?}, {late} cycles late", scheme(&world)));
        }
    }
}

/// The control rejects every write for 10 s: the state becomes `faulted` after `zero_after_ms`, and the guard shows no
/// applied correction.
#[test]
fn refused_writes_are_a_fault_and_nothing_is_shown_as_applied() {
    for mut world in all(&with_delay(1)) {
        (world.sticks, world.write_fails) = (false, true);
        world.request(Request::Arm);
        let is_faulted = |world: &mut World| world.run(Duration::ZERO).state.name() == "faulted";
        let states: Vec<bool> = (0..2500).map(|_| is_faulted(&mut world)).collect();
        let kind = scheme(&world);
        // After `zero_after_ms`, here 500 ms.
        assert!(states[..300].contains(&true), "{kind:?}");
        assert_eq!(world.guard.output(), PerChannel::ZERO, "{kind:?}");
        assert_eq!(world.applied, PerChannel::ZERO, "{kind:?}");
    }
}

/// Y rejects its words while X follows a moving machine: the guard faults within 5 s. Each row has the request for Y and the motion of X.
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
        let case = format!("Y {y} mm, X ±{x_um} µm at {hz} Hz");
        let mut world = World::new(&with_delay(1));
        world.request(Request::Arm);
        // The fault follows after three requests for a step of Y.
        let is_faulted = (0..1250_u32).any(|cycle| {
            let at_s = f64::from(cycle) * 0.004;
            world.target = Some(axes(x_um * 1e-3 * (TAU * hz * at_s).sin(), y));
            let output = world.run(Duration::ZERO);
            world.applied[1] = 0.0;
            world.assert_steps(MOST, &case);
            output.state.name() == "faulted"
        });
        assert!(is_faulted, "{case}");
    }
}

/// Lines reject writes and keep 40 µm while the guard ramps to zero: when they accept writes again, the axis makes no
/// step.
#[test]
fn restored_lines_make_no_step() {
    for arms_again in [false, true] {
        let mut world = World::lines(&limits()).arm();
        let held = world.applied;
        (world.answers, world.sticks, world.write_fails) = (false, false, true);
        world.run(Duration::from_millis(1200));
        assert_eq!(world.guard.output(), held, "the levels are known");
        (world.answers, world.sticks, world.write_fails) = (true, true, false);
        if arms_again {
            world.run(2 * SECOND);
            world.request(Request::Acknowledge);
            world.request(Request::Arm);
        }
        world.run(3 * SECOND);
        world.assert_steps(MOST, "restored");
        let (x, state) = (world.applied[0], world.guard.state());
        assert!(x.abs() < 1e-9 || (x - held[0]).abs() < 1e-9, "{x}");
        assert!(!arms_again || state == COMPENSATING, "{state:?}");
    }
}

/// A reading is lost during an emergency stop in the ramp-out: the stop remains known, and the axis stays where it is.
#[test]
fn a_lost_reading_does_not_lift_an_emergency_stop() {
    for world in all(&limits()) {
        let mut world = world.arm();
        world.request(Request::Disarm);
        world.run(Duration::from_millis(100));
        world.emergency_stop = true;
        world.run(Duration::from_millis(20));
        let held = world.applied;
        assert!(held[0].abs() > 0.010, "on the ramp: {held:?}");
        for lost in [PERIOD, Duration::from_millis(200), 5 * SECOND] {
            world.answers = false;
            world.run(lost);
            world.answers = true;
            world.run(SECOND / 10);
            assert_eq!(world.applied, held, "{:?} moved", scheme(&world));
        }
        world.emergency_stop = false;
        world.largest_step = 0.0;
        world.run_to(2 * SECOND, State::Disarmed);
        assert_eq!(world.applied, PerChannel::ZERO);
        world.assert_steps(MOST, "after the stop");
    }
}

/// A read-back of NaN for 5 s: the state is not `compensating`, and no axis steps.
#[test]
fn a_nan_read_back_is_not_reported_as_compensating() {
    for world in readable(&limits()) {
        let mut world = world.arm();
        world.target = Some(axes(-0.080, 0.0));
        for _ in 0..1250 {
            world.false_reading = Some(axes(f64::NAN, f64::NAN));
            world.flipped_word = Some((3, 0xffff));
            let output = world.run(Duration::ZERO);
            assert!(world.barrier.is_some() || !output.write);
        }
        assert_ne!(world.guard.state(), COMPENSATING, "{:?}", scheme(&world));
        world.assert_steps(MOST, "NaN");
        (world.false_reading, world.flipped_word) = (None, None);
        world.run(3 * SECOND);
        world.assert_steps(MOST, "after NaN");
    }
}

/// The control does not report the correction for some cycles. Without a barrier the correction is cleared in the
/// meantime; a barrier ramps out at its timeout. The guard ramps back to 40 µm.
#[test]
fn a_correction_that_is_not_reported_comes_back_by_a_ramp() {
    for silent in [1, 3, 12, 100, 500] {
        for world in readable(&limits()) {
            let mut world = world.arm();
            let case = format!("{:?}, silent for {silent} cycles", scheme(&world));
            let (requested, has_barrier) = (world.applied, world.barrier.is_some());
            world.hides_correction = true;
            world.clear(PerChannel::ZERO);
            for _ in 0..silent {
                world.run(Duration::ZERO);
                let at = world.applied[0].abs();
                assert!(has_barrier || at <= MOST, "{case}: {at}");
            }
            // The barrier is at zero after 50 ms hold + 200 ms timeout + 20 ms ramp.
            let is_zero = world.applied == PerChannel::ZERO;
            assert!(!has_barrier || silent < 70 || is_zero, "{case}");
            world.hides_correction = false;
            world.run(3 * SECOND);
            world.assert_steps(MOST, &case);
            assert_eq!(world.applied, requested, "{case}");
        }
    }
}

/// The program is suspended for 2 s between read and write, and the control is cleared: the expired write is not sent.
#[test]
fn an_expired_decision_is_not_sent() {
    for world in readable(&limits()) {
        let mut world = world.arm();
        world.target = Some(axes(0.100, 0.0));
        world.largest_step = 0.0;
        let (_, sent) = world.cycle_with_pause(PERIOD, 2 * SECOND, None);
        assert!(!sent, "{:?}", scheme(&world));
        world.clear(PerChannel::ZERO);
        world.run(3 * SECOND);
        world.assert_steps(MOST, "after the pause");
        assert!((world.applied[0] - 0.100).abs() < 1e-9);
    }
}

/// Two readings repeat a write from 32 ms ago, as on a late path. A later value was already confirmed, so the axis does
/// not step back to the repeated one.
#[test]
fn readings_that_repeat_an_earlier_write_make_no_step() {
    for (repeated, back) in (1..12).flat_map(|repeated| (1..=8).map(move |back| (repeated, back))) {
        let mut world = World::new(&with_delay(8)).arm_from_here();
        let mut past = Vec::new();
        while world.applied[0] < 0.025 {
            world.run(Duration::ZERO);
            past.push(world.applied);
        }
        for _ in 0..repeated {
            world.false_reading = Some(past[past.len() - 1 - back]);
            world.run(Duration::ZERO);
        }
        world.false_reading = None;
        world.run_to(2 * SECOND, COMPENSATING);
        world.assert_steps(MOST, &format!("{repeated} times, {back} back"));
        assert_eq!(world.applied, axes(0.040, -0.020));
    }
}

/// With late readings and lost writes, any write since the last confirmed one may be applied: the next write must be
/// close to all these writes.
#[test]
fn a_lost_write_before_a_late_reading_makes_no_step() {
    for pattern in 0..64_u32 {
        let mut world = World::new(&with_delay(8)).arm();
        world.report_delay = 7;
        for cycle in 0..2000_u32 {
            let wave = 0.004 * (TAU * f64::from(cycle) * 0.02).sin();
            world.target = Some(axes(0.040 + wave, -0.020));
            world.sticks = pattern >> (cycle / 3 % 6) & 1 == 0;
            world.run(Duration::ZERO);
        }
        world.assert_steps(MOST, &format!("pattern {pattern:b}"));
    }
}

/// During another fault, three false readings of 1.5 mm are not written to the axis. A real correction of 1.5 mm stays
/// applied until the operator acknowledges the fault.
#[test]
fn a_correction_beyond_the_limit_needs_acknowledgement_in_any_fault() {
    let faulted = || {
        let mut world = World::new(&with_delay(1)).arm();
        (world.sticks, world.target) = (false, Some(axes(0.080, -0.080)));
        world.run_to(SECOND, DOES_NOT_STICK);
        world.sticks = true;
        world.run(2 * SECOND);
        assert_eq!(world.applied, PerChannel::ZERO);
        world.largest_step = 0.0;
        world
    };
    let mut world = faulted();
    for _ in 0..300 {
        world.false_reading = Some(axes(1.5, 0.0));
        assert!(!world.run(Duration::ZERO).write || world.largest_step == 0.0);
    }
    world.assert_steps(MOST, "false readings");
    let mut world = faulted();
    world.clear(axes(1.5, 0.0));
    world.run_to(2 * SECOND, State::Faulted(Cause::BeyondLimit));
    assert_eq!(world.applied, axes(1.5, 0.0), "nothing is written");
    world.request(Request::Acknowledge);
    world.run_to(5 * SECOND, State::Disarmed);
    assert_eq!(world.applied, PerChannel::ZERO);
    world.assert_steps(MOST, "acknowledged");
}

/// A reading dated 10 s ahead does not make its positions fresh: the state becomes `holding` when the positions are
/// old.
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

/// A wrong report that is repeated with every new position counts as one reading, so the axis does not step.
#[test]
fn one_repeated_message_is_one_reading() {
    let mut world = World::new(&with_delay(15));
    // As long as the maximum lag of the path.
    for _ in 0..15 {
        world.false_reading = Some(axes(-0.020, 0.0));
        world.run(Duration::ZERO);
    }
    world.false_reading = None;
    let mut world = world.arm_from_here();
    world.run(2 * SECOND);
    world.assert_steps(MOST, "armed");
}

/// The barrier accepts frames but the control holds the axis: the correction is reported as unconfirmed.
#[test]
fn an_axis_that_does_not_follow_is_reported() {
    let mut world = World::guarded(&with_delay(1)).arm();
    world.target = Some(axes(0.140, 0.0));
    let held = world.barrier.expect("a barrier").memory().applied;
    let mut reported = 0;
    for _ in 0..100 {
        // Tick and sequence advance; the applied correction does not.
        let barrier = world.barrier.expect("a barrier");
        let memory = Memory { applied: held, from: held, ..barrier.memory() };
        world.barrier = Some(Barrier::resume(barrier.report().settings, memory).expect("valid"));
        let output = world.run(Duration::ZERO);
        reported += usize::from(output.reasons.contains(Reasons::SLEWING));
    }
    assert!(reported > 20, "{reported} of 100 cycles");
}

/// After a restart of the control its scans are counted anew, without a report that the barrier is unfit, and the correction returns.
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
        assert_eq!(world.guard.state(), COMPENSATING);
        assert!((world.applied[0] - 0.040).abs() < 1e-9);
    }
}

/// The reason is reported with the value found and the expected value: a limit of 150 µm in the barrier, and scans that
/// take twice the configured time.
#[test]
fn a_barrier_that_does_not_fit_is_named_with_its_value() {
    let near = |found: f64, expected: f64| (found - expected).abs() < 1e-9;
    let mut limits = limits();
    for axis in &mut limits.axes {
        axis.limit = 0.200;
    }
    let mut world = World::guarded(&limits);
    let output = world.run(Duration::ZERO);
    assert!(output.reasons.contains(Reasons::BARRIER_UNFIT));
    let misfit = world.status().barrier_misfit;
    assert!(
        matches!(misfit, Some(BarrierMisfit::Limit { axis: 0, found, expected }) if near(found, 0.150) && near(expected, 0.200)),
        "{misfit:?}"
    );
    let mut world = World::guarded(&crate::world::limits());
    assert_eq!(world.status().barrier_misfit, None);
    world.scan_time = 2 * SCAN;
    let output = world.run(3 * SECOND);
    assert!(output.reasons.contains(Reasons::BARRIER_UNFIT));
    let misfit = world.status().barrier_misfit;
    assert!(
        matches!(misfit, Some(BarrierMisfit::ScanPeriod { found, expected: SCAN }) if found.abs_diff(2 * SCAN) < SCAN / 10),
        "{misfit:?}"
    );
}

/// Repeated short outages, in each of which the barrier ramps to zero, are a fault. After the acknowledgement of the
/// fault the earlier failures do not count, and arming works.
#[test]
fn arming_works_after_an_acknowledged_fault() {
    let mut faults = 0;
    for silent in [50, 100, 190, 250, 300, 460] {
        for mut world in readable(&limits()).into_iter().map(World::arm) {
            for _ in 0..20 {
                world.answers = false;
                world.run(Duration::from_millis(silent));
                world.answers = true;
                world.run(Duration::from_millis(10));
            }
            world.run(SECOND);
            if world.guard.state() == DOES_NOT_STICK {
                faults += 1;
                world.request(Request::Acknowledge);
                world.run_to(SECOND, State::Disarmed);
                world.request(Request::Arm);
            }
            world.run_to(2 * SECOND, COMPENSATING);
            assert!((world.applied[0] - 0.040).abs() < 1e-9);
            world.assert_steps(MOST, &format!("silent for {silent} ms"));
        }
    }
    assert!(faults > 0, "no fault occurred");
}

const MS: Duration = Duration::from_millis(1);

/// Receives the same values in several cycles, each dated `late` before the cycle; returns the last status and its time.
fn received(read_back: &mut ReadBack, late: Duration) -> (ReadBackStatus, Duration) {
    let (limits, values) = (limits(), PerChannel::leading([5.0 * STEP]));
    let mut now = Duration::from_secs(1);
    for _ in 0..20 {
        now += PERIOD;
        read_back.receive(
            now,
            now.saturating_sub(late),
            &CorrectionReport::Values(values),
            &limits,
        );
    }
    (*read_back.status(), now)
}

/// A reading confirms the correction at the time of the reading, also if it is received later; a reading older than
/// `hold` confirms no correction.
#[test]
fn a_reading_confirms_as_of_its_own_time() {
    let hold = limits().hold;
    for late in [Duration::ZERO, 7 * MS, hold] {
        let (known, now) = received(&mut ReadBack::plain(Duration::ZERO), late);
        let confirmed = known.confirmed.expect("three equal readings");
        assert_eq!(confirmed.at, now.saturating_sub(late));
        assert!((confirmed.values[0] - 5.0 * STEP).abs() < 1e-12);
    }
    let (known, _) = received(&mut ReadBack::plain(Duration::ZERO), hold + MS);
    assert_eq!((known.confirmed, known.writable), (None, false));
}

/// A repeated reading ages and permits no write. Only time in which readings arrive counts towards the time of missing
/// corrections.
#[test]
fn a_repeated_reading_ages() {
    let limits = limits();
    let mut read_back = ReadBack::plain(Duration::ZERO);
    let (known, last) = received(&mut read_back, Duration::ZERO);
    let values = known.confirmed.expect("confirmed").values;
    let mut now = last;
    for _ in 0..2000 {
        now += PERIOD;
        read_back.receive(now, last, &CorrectionReport::Values(values), &limits);
        read_back.sent(now, &PerChannel::leading([6.0 * STEP]), true);
    }
    let known = read_back.status();
    assert_eq!(known.confirmed.map(|confirmed| confirmed.at), Some(last));
    assert!(!known.writable);
    let unlanded = known.unlanded_since.map(|since| now.saturating_sub(since));
    assert!(unlanded.is_some_and(|time| time < limits.zero_after), "{unlanded:?}");
}

#[test]
fn late_readings_reveal_the_levels_of_lines() {
    let control = ControlTimeOut { after: 200 * MS, to_zero: 100 * MS };
    for control in [None, Some(control)] {
        let mut read_back = ReadBack::no_read_back(control);
        let unknown = PerChannel::from_fn(|_| f64::NAN);
        read_back.restore(Duration::ZERO, &unknown, Duration::ZERO, &limits());
        assert_eq!(read_back.status().confirmed, None);
        let (known, now) = received(&mut read_back, 7 * MS);
        let at = known.confirmed.map(|confirmed| confirmed.at);
        // Lines do not show whether their control has ramped to zero.
        let expected = if control.is_none() { now.saturating_sub(7 * MS) } else { now };
        assert_eq!(at, Some(expected), "{control:?}");
        assert!(known.writable);
    }
}

#[test]
fn extreme_times_and_counts_do_not_panic() {
    use volcomp_guard::{
        BarrierLink, ControlTimeOut, Limits, barrier::Settings, barrier_misfits, scans_fit,
    };
    let limits = Limits { count: 1000, ..crate::world::limits() };
    let settings = Settings {
        axes: crate::world::layout(),
        machine: 1,
        limit: PerChannel([1; 9]),
        rate: PerChannel([0; 9]),
        step_scans: u16::MAX,
        hold_scans: u16::MAX,
        time_out_scans: u16::MAX,
    };
    let endless = Duration::MAX;
    assert!(barrier_misfits(&settings, endless, &limits).count() > 0);
    assert!(!scans_fit(u32::MAX, Duration::from_secs(1), endless));
    let time_out = ControlTimeOut { after: endless, to_zero: endless };
    for mut read_back in [
        ReadBack::plain(endless),
        ReadBack::no_read_back(Some(time_out)),
        ReadBack::barrier(BarrierLink::new(1, 2, crate::world::layout(), endless)),
    ] {
        for now in [Duration::ZERO, endless] {
            let values = PerChannel([0.001; 9]);
            read_back.receive(now, now, &CorrectionReport::Values(values), &limits);
            read_back.restore(now, &values, endless, &limits);
            read_back.sent(now, &values, true);
            read_back.receive(now, endless, &CorrectionReport::Barrier(&[u16::MAX; 60]), &limits);
            read_back.take_over(now, false);
            read_back.acknowledge(now);
            let _ = (read_back.zero_after_last_write(&limits), read_back.status().holds(&limits));
        }
    }
}
