//! Limits and accelerations that change while a correction is applied, also at random.
//!
//! The whole vector returns on one straight line.

use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{
    BarrierLink, Cause, CorrectionReport, Interlock, Limits, ReadBack, Request,
    RequestedCorrection, State, Vector, barrier::REPORT_WORDS,
};
use volcomp_vocabulary::{AxisKind, PerChannel};

use crate::{
    vector::{five, of, three},
    world::{
        self, CLEAR, MACHINE, PERIOD, SCAN, SLEW, STEP, STOP, World, axes, layout, same_places,
    },
};

const CYCLE_S: f64 = 0.004;

/// A request in which X follows A with 500 mm/rad and has no position share: the tip error is X − 500·A.
fn following_a() -> RequestedCorrection {
    let mut follow = PerChannel::default();
    follow[3] = of([500.0]);
    RequestedCorrection {
        rotary: of([0.0, 0.0, 0.0, 200e-6]),
        follow,
        ..RequestedCorrection::default()
    }
}

/// X and A of a tilting head, with small output steps.
fn tilting(rotary_slew: f64) -> Limits {
    let mut limits = five(0.0);
    for (i, axis) in limits.axes.iter_mut().enumerate().take(5) {
        axis.resolution = if i < 3 { 1e-5 } else { 1e-7 };
    }
    limits.axes[3].limit = 400e-6;
    limits.axes[3].slew_per_s = rotary_slew;
    limits
}

fn with_accel(limits: &Limits, accel_per_s2: f64) -> Limits {
    let mut limits = *limits;
    for axis in &mut limits.axes {
        axis.accel_per_s2 = accel_per_s2;
    }
    limits
}

/// Largest tip error (mm) while the guard reduces the correction to the lowered limits, and the vector at the end.
fn misses_most(requested: &RequestedCorrection, before: &Limits, after: &Limits) -> (f64, Vector) {
    let mut vector = Vector::at(&PerChannel::ZERO);
    for _ in 0..2000 {
        vector.follow(requested, before, CYCLE_S);
    }
    vector.begin_ramp();
    let mut most = 0.0_f64;
    for _ in 0..2000 {
        vector.follow(requested, after, CYCLE_S);
        let output = vector.output();
        most = most.max((output[0] - 500.0 * output[3]).abs());
    }
    (most, vector)
}

/// The limit of X is lowered: X and A are reduced together. If X alone were reduced at its slew, the tip would be 50 µm off.
#[test]
fn a_lowered_linear_limit_reduces_the_rotary_shares_too() {
    for rotary_slew in [2000e-6, 500e-6, 250e-6, 50e-6] {
        let before = tilting(rotary_slew);
        let mut after = before;
        after.axes[0].limit = 0.030;
        let (most, vector) = misses_most(&following_a(), &before, &after);
        assert!(most < 1e-4, "{rotary_slew}: {most}");
        let [x, a] = [vector.output()[0], vector.output()[3]];
        assert!((x - 0.030).abs() < 1e-5 && (a - 60e-6).abs() < 1e-7, "{x} {a}");
    }
}

#[test]
fn a_lowered_rotary_limit_reduces_the_linear_shares_too() {
    let before = tilting(2000e-6);
    let mut after = before;
    after.axes[3].limit = 50e-6;
    let (most, vector) = misses_most(&following_a(), &before, &after);
    assert!(most < 1e-4, "{most}");
    assert!((vector.output()[0] - 0.025).abs() < 1e-5);
}

/// A line whose end is beyond a lowered limit is scaled by one factor as a whole, so that the tool tip stays in place.
#[test]
fn a_line_that_ends_beyond_a_lowered_limit_is_scaled_as_a_whole() {
    let before = tilting(2000e-6);
    let to = following_a().full();
    for (linear, rotary) in [(1.0, 0.2), (0.2, 1.0), (0.3, 0.2)] {
        let mut after = before;
        after.axes[0].limit *= linear;
        after.axes[3].limit *= rotary;
        let mut vector = Vector::at(&to);
        vector.begin_line(&to);
        let mut most = 0.0_f64;
        while !vector.advance_line(&after, CYCLE_S) {
            let output = vector.output();
            most = most.max((output[0] - 500.0 * output[3]).abs());
        }
        // One step of A at its lever, because words are rounded towards zero during a reduction, and one step of X.
        assert!(most <= 1e-7 * 500.0 + 1e-5, "{linear} {rotary}: {most}");
        let within = |i: usize| vector.output()[i].abs() <= after.axes[i].limit * (1.0 + 1e-9);
        assert!(within(0) && within(3), "{vector:?}");
    }
}

/// Without rotary axes a lowered limit scales all shares by one factor.
#[test]
fn a_lowered_limit_scales_every_share_equally() {
    let requested = RequestedCorrection::linear(of([0.100, -0.050, 0.020]));
    let before = three();
    let mut after = before;
    after.axes[0].limit = 0.030;
    let mut vector = Vector::at(&requested.position);
    for _ in 0..200 {
        vector.follow(&requested, &before, CYCLE_S);
    }
    vector.begin_ramp();
    let mut cycles = 0;
    while !vector.is_ramped() {
        vector.follow(&requested, &after, CYCLE_S);
        let [x, y, z, ..] = vector.smooth().0;
        assert!((x + 2.0 * y).abs() < 1e-9 && (x - 5.0 * z).abs() < 1e-9);
        cycles += 1;
    }
    assert!((124..=126).contains(&cycles), "{cycles}");
    assert_eq!(vector.output(), of([0.030, -0.015, 0.006]));
}

/// A moving axis brakes with the previous acceleration until at rest, so that a lowered acceleration does not make it overshoot.
#[test]
fn a_lowered_acceleration_does_not_overshoot() {
    let requested = RequestedCorrection::linear(of([0.091, -0.040, 0.0]));
    for (cycles, part) in [(10, 0.1), (30, 0.025), (40, 0.005), (20, 0.005)] {
        let before = Limits { ramp: Duration::from_millis(100), ..with_accel(&three(), 20.0) };
        let after = with_accel(&before, 20.0 * part);
        let mut vector = Vector::at(&PerChannel::ZERO);
        let mut rate = 0.0;
        let mut follow = |vector: &mut Vector, limits: &Limits, accel_per_s2: f64| {
            let stood = vector.smooth()[0];
            vector.follow(&requested, limits, CYCLE_S);
            let now = (vector.smooth()[0] - stood) / CYCLE_S;
            let most = accel_per_s2 * CYCLE_S * (1.0 + 1e-6);
            assert!((now - rate).abs() <= most, "{rate} to {now}");
            rate = now;
            now == 0.0
        };
        for _ in 0..cycles {
            follow(&mut vector, &before, 20.0);
        }
        vector.begin_ramp();
        let (mut most, mut stood) = (0.0_f64, false);
        for _ in 0..20_000 {
            let accel_per_s2 = if stood { 20.0 * part } else { 20.0 };
            stood |= follow(&mut vector, &after, accel_per_s2);
            most = most.max(vector.smooth()[0]);
        }
        assert!(most <= 0.091 + 1e-9, "{part} after {cycles}: {most}");
        assert!(vector.is_ramped());
        assert!((vector.output()[0] - 0.091).abs() < 1e-9);
    }
}

/// Limits are lowered while words to a slow barrier are in transit: these words are not taken for a foreign correction, and the guard
/// keeps compensating.
#[test]
fn limits_lowered_in_motion_on_a_slow_path_are_no_fault() {
    for late in [0, 1, 2, 4, 6] {
        for after in [60, 80, 100, 120, 140] {
            for limit in [0.100, 0.030] {
                let mut world = World::ramping(late, after);
                world.largest_step = 0.0;
                world.lower_limits(limit);
                world.request(Request::Switched);
                let state = world.run(Duration::from_secs(2)).state;
                let case = format!("{late} cycles late, after {after}, to {limit}");
                assert_eq!(state, State::Compensating, "{case}: {:?}", world.applied);
                assert!((world.applied[0] - limit).abs() < 1e-9, "{case}");
                // The barrier moves at twice the slew, but by no more than the slew in one cycle.
                assert!(world.largest_step <= 0.002 + 1e-9, "{case}");
            }
        }
    }
}

/// Limits are lowered in motion with a late read-back, also at the start of a stop: no fault.
#[test]
fn limits_lowered_in_motion_without_a_barrier_are_no_fault() {
    for late in [0, 1, 2, 4, 6] {
        for after in [60, 80, 100, 120, 140] {
            for (limit, emergency_stop) in
                [(0.100, false), (0.030, false), (0.100, true), (0.030, true)]
            {
                let mut world =
                    World::new(&Limits { read_back_cycles: late + 2, ..world::limits() });
                world.report_delay = late;
                world.target = Some(axes(0.140, -0.070));
                world.request(Request::Arm);
                world.run(after * PERIOD);
                world.lower_limits(limit);
                world.interlocks.update(1, if emergency_stop { STOP } else { CLEAR });
                world.request(Request::Switched);
                world.run(Duration::from_secs(1));
                world.interlocks.update(1, CLEAR);
                let state = world.run(Duration::from_secs(3)).state;
                let case = format!("{late} cycles late, after {after}, to {limit}");
                assert_eq!(state, State::Compensating, "{case}, {emergency_stop}");
                assert!(world.largest_step <= 0.002 + 1e-9, "{case}");
            }
        }
    }
}

#[test]
fn a_correction_sent_long_before_a_limit_was_lowered_is_a_fault() {
    for found in [0.140, 0.040] {
        let mut world = World::new(&world::limits());
        world.target = Some(axes(0.140, -0.070));
        world.request(Request::Arm);
        world.run(Duration::from_secs(2));
        world.lower_limits(0.030);
        world.request(Request::Switched);
        world.run(Duration::from_secs(2));
        assert!((world.applied[0] - 0.030).abs() < 1e-9);
        world.request(Request::Disarm);
        world.run(Duration::from_secs(2));
        world.clear(axes(found, 0.0));
        world.run(Duration::from_secs(2));
        let state = world.request(Request::Arm).state;
        assert_eq!(state, State::Faulted(Cause::BeyondLimit), "{found}");
    }
}

/// A path with another axis order and a limit of 30 µm takes over from a path that applies 140 and −70 µm. It ramps
/// both axes down by one factor, without a fault.
#[test]
fn a_path_with_lower_limits_reduces_the_previous_correction_by_a_ramp() {
    // Corrections found at the take-over: the sent ones, larger ones, and, on one axis, the word that was sent for the
    // other axis.
    for (found, is_expected) in
        [(axes(-0.070, 0.140), true), (axes(-0.070, 0.142), false), (axes(-0.140, 0.140), false)]
    {
        let mut world = World::compensating(&world::limits());
        world.target = Some(axes(0.140, -0.070));
        world.run(Duration::from_secs(2));
        let mut lower = world::limits();
        for axis in &mut lower.axes {
            (axis.limit, axis.warn) = (0.030, 0.030);
        }
        let places = PerChannel::leading([Some(1), Some(0)]);
        world.guard.take_path(lower, &places).expect("valid");
        world.read_back = ReadBack::plain(Duration::ZERO);
        world.applied = found;
        world.target = Some(axes(-0.070, 0.140));
        world.largest_step = 0.0;
        world.request(Request::TakeOver);
        let state = world.run(Duration::from_secs(3)).state;
        if is_expected {
            assert_eq!(state, State::Compensating, "{:?}", world.applied);
            let comes_in = axes(-0.015, 0.030);
            let off = |i: usize| (world.applied[i] - comes_in[i]).abs();
            assert!(off(0) < 1e-9 && off(1) < 1e-9, "{:?}", world.applied);
            assert!(world.largest_step <= 0.002 + 1e-9);
        } else {
            assert_eq!(state, State::Faulted(Cause::BeyondLimit), "{found:?}");
            assert_eq!(world.applied, found);
        }
    }
}

/// Two path changes in a row, the second before the path in between has reported a correction: corrections sent on the
/// first path are still accepted.
#[test]
fn sent_corrections_are_carried_over_two_changes_of_path() {
    let mut world = World::compensating(&world::limits());
    world.target = Some(axes(0.140, -0.020));
    world.run(Duration::from_secs(2));
    let mut lower = world::limits();
    for axis in &mut lower.axes {
        (axis.limit, axis.warn) = (0.030, 0.030);
    }
    let places = PerChannel::leading([Some(1), Some(0)]);
    for limits in [world::limits(), lower] {
        world.guard.take_path(limits, &places).expect("valid");
        world.read_back.take_over(world.now, false);
    }
    world.request(Request::TakeOver);
    let state = world.run(Duration::from_secs(3)).state;
    assert_eq!(state, State::Compensating, "{:?}", world.applied);
    // An axis that the previous path did not write has no sent words.
    let mut world = World::compensating(&world::limits());
    world.target = Some(axes(0.140, -0.020));
    world.run(Duration::from_secs(2));
    let places = PerChannel::leading([None, Some(1)]);
    world.guard.take_path(lower, &places).expect("valid");
    world.read_back.take_over(world.now, false);
    world.request(Request::TakeOver);
    let state = world.run(Duration::from_secs(3)).state;
    assert_eq!(state, State::Faulted(Cause::BeyondLimit));
}

/// X follows A with a lever that changes in every cycle. When the limits are lowered, the remaining correction is
/// reduced to the new limits before the test shift.
#[test]
fn limits_lowered_before_arming_apply_while_the_machine_moves() {
    let mut limits = world::limits();
    let a = &mut limits.axes[1];
    (a.kind, a.limit, a.warn) = (AxisKind::Rotary, 0.0015, 0.001);
    (a.slew_per_s, a.resolution) = (0.0005, 1e-6);
    limits.test_shift = axes(0.005, 20e-6);
    for moves in [0.0, 0.05] {
        let mut world = World::new(&limits);
        world.applied = axes(0.140, 200e-6);
        world.positions = axes(10.0, 0.5);
        world.follow[1] = axes(100.0, 0.0);
        world.run(Duration::from_secs(1));
        let mut lower = limits;
        (lower.axes[0].limit, lower.axes[0].warn) = (0.030, 0.030);
        world.guard.set_limits(lower).expect("valid");
        world.target = Some(axes(0.010, 0.0));
        world.request(Request::Arm);
        assert_eq!(world.guard.state().name(), "arming");
        for _ in 0..1000 {
            world.positions[0] += 0.2 * moves;
            world.positions[1] += 0.002 * moves;
            world.follow[1][0] += moves;
            world.run(Duration::ZERO);
        }
        let at = world.applied[0];
        assert!(at <= 0.030 + 1e-9, "{moves}: {at}");
    }
}

/// Random limits of up to 150 output steps.
fn any_limits(world: &World, random: &mut ChaCha8Rng) -> Limits {
    let mut limits = *world.guard.limits();
    let limit = f64::from(random.random_range(5..150)) * STEP;
    for axis in &mut limits.axes {
        (axis.limit, axis.warn) = (limit, limit);
    }
    limits
}

fn any_target(random: &mut ChaCha8Rng) -> PerChannel<f64> {
    let mut share = || random.random_range(-0.2..0.2);
    axes(share(), share())
}

/// Another path reports whether there is an emergency stop.
fn shows(world: &mut World, emergency_stop: bool) {
    let interlock = Interlock { emergency_stop, ..Interlock::default() };
    world.interlocks.update(1, Some(interlock));
}

fn read_standby(standby: &mut ReadBack, world: &World) {
    let Some(barrier) = &world.barrier else {
        return;
    };
    let mut words = [0; REPORT_WORDS];
    let length = barrier.report().encode(&mut words);
    let reported = CorrectionReport::Barrier(&words[..length]);
    standby.receive(world.now, world.now, &reported, world.guard.limits());
}

/// A barrier with a delay of some cycles, and a second path to it: random changes of limits are not a fault, words keep
/// the slew, and no axis moves in a stop.
#[test]
fn random_changes_of_limits_are_no_fault() {
    // Random seeds, and fixed ones: three in which an axis moved during a stop, one in which a sent correction was a fault.
    for seed in (0..60).chain([81, 237, 320, 1473]) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let late = random.random_range(0..5);
        let mut world = World::ramping(late, random.random_range(20..150));
        let takes_over = seed % 2 == 1;
        let mut standby = ReadBack::barrier(BarrierLink::new(99, MACHINE, layout(), SCAN));
        standby.also_sent(world.read_back.last_frame().expect("it moves"));
        // Words in transit at the start of the stop have arrived.
        let settled = 2 * late + 6;
        let (mut word, mut written) = (Some(world.guard.output()[0]), 0);
        let (mut stopped, mut stood) = (0_usize, world.applied);
        for cycle in 1..3000 {
            let mut request = None;
            let is_clear = world.interlocks.reasons().is_empty();
            match random.random_range(0..120) {
                0 | 1 => {
                    let limits = any_limits(&world, &mut random);
                    world.guard.set_limits(limits).expect("valid");
                    request = Some(Request::Switched);
                }
                2 if !world.emergency_stop => {
                    let emergency_stop = random.random();
                    shows(&mut world, emergency_stop);
                }
                3 if world.emergency_stop || is_clear => {
                    // The control is stopped for longer than another path reports the stop.
                    world.emergency_stop ^= true;
                    shows(&mut world, false);
                }
                4 => world.target = Some(any_target(&mut random)),
                5 if is_clear && !world.emergency_stop => world.holds ^= true,
                6 => request = Some(Request::Disarm),
                7..10 => request = Some(Request::Arm),
                10 | 11 if takes_over => {
                    let limits = any_limits(&world, &mut random);
                    if is_clear && !matches!(world.guard.state(), State::Faulted(_)) {
                        let places = same_places();
                        world.guard.take_path(limits, &places).expect("valid");
                        std::mem::swap(&mut world.read_back, &mut standby);
                        request = world.guard.state().is_armed().then_some(Request::TakeOver);
                        word = None;
                    }
                }
                _ => {}
            }
            let output = world.cycle_after(PERIOD, request);
            if let Some(frame) = world.read_back.last_frame() {
                standby.also_sent(frame);
            }
            let case = format!("seed {seed}, {late} late, cycle {cycle}, {:?}", output.state);
            let beyond = State::Faulted(Cause::BeyondLimit);
            assert_ne!(output.state, beyond, "{case}");
            let other = State::Faulted(Cause::OtherGateway);
            assert_ne!(output.state, other, "{case}: there is one gateway");
            if output.write {
                let now = output.correction[0];
                let change = word.map_or(0.0, |word| (now - word).abs());
                let passed_s = PERIOD.as_secs_f64() * f64::from(cycle - written);
                assert!(change <= SLEW * passed_s + STEP + 1e-9, "{case}: {change}");
                (word, written) = (Some(now), cycle);
            }
            if cycle % 8 == 0 {
                read_standby(&mut standby, &world);
            }
            let is_clear = world.interlocks.reasons().is_empty();
            stopped = if is_clear { 0 } else { stopped + 1 };
            if stopped == settled {
                stood = world.applied;
            }
            if stopped > settled && !world.holds {
                assert_eq!(world.applied, stood, "{case}");
            }
        }
    }
}

/// Permitted range of a correction, mm: one step plus the slew from every earlier value.
struct Window {
    lowest: f64,
    highest: f64,
}

impl Window {
    fn about(value: f64) -> Self {
        Self { lowest: value - STEP, highest: value + STEP }
    }

    /// Widens the range by the largest slew; returns how far the new value is outside.
    fn goes(&mut self, slewed: f64, value: f64) -> f64 {
        let (lowest, highest) = (self.lowest - slewed, self.highest + slewed);
        let about = Self::about(value);
        self.lowest = lowest.max(about.lowest);
        self.highest = highest.min(about.highest);
        (lowest - value).max(value - highest)
    }
}

/// Without a barrier, with a late or missing read-back, and with a path that has another axis order: random changes of
/// limits are not a fault.
#[test]
fn random_changes_of_limits_without_a_barrier_are_no_fault() {
    for seed in 0..400_u64 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let late = random.random_range(0..5);
        let mut world = World::new(&Limits { read_back_cycles: late + 2, ..world::limits() });
        world.report_delay = late;
        world.target = Some(axes(0.140, -0.070));
        world.request(Request::Arm);
        let mut windows = [0, 1].map(|i| Window::about(world.applied[i]));
        let mut slew = [SLEW; 2];
        for cycle in 1..2500 {
            let mut request = None;
            match random.random_range(0..150) {
                0..3 => {
                    let mut limits = any_limits(&world, &mut random);
                    let slew_per_s = [0.5, 0.25, 0.05, 0.01][random.random_range(0..4)];
                    let accel_per_s2 = [20.0, 1.0, f64::INFINITY][random.random_range(0..3)];
                    slew[1] = slew_per_s;
                    for axis in &mut limits.axes {
                        (axis.slew_per_s, axis.accel_per_s2) = (slew_per_s, accel_per_s2);
                    }
                    world.guard.set_limits(limits).expect("valid");
                    request = Some(Request::Switched);
                }
                3 | 4 => {
                    let emergency_stop = random.random();
                    shows(&mut world, emergency_stop);
                }
                5 => world.target = Some(any_target(&mut random)),
                6 => request = Some(Request::Disarm),
                7..10 => request = Some(Request::Arm),
                10 if seed % 2 == 1 && world.interlocks.reasons().is_empty() => {
                    let limits = any_limits(&world, &mut random);
                    let places = PerChannel::leading([Some(1), Some(0)]);
                    world.guard.take_path(limits, &places).expect("valid");
                    world.read_back = ReadBack::plain(Duration::ZERO);
                    world.read_back.take_over(world.now, false);
                    world.applied = axes(world.applied[1], world.applied[0]);
                    windows.reverse();
                }
                11 if seed % 3 == 1 => world.answers = false,
                12..16 => world.answers = true,
                _ => {}
            }
            let before = world.applied;
            let output = world.cycle_after(PERIOD, request);
            let case = format!("seed {seed}, {late} late, cycle {cycle}, {:?}", output.state);
            let is_beyond = output.state == State::Faulted(Cause::BeyondLimit);
            assert!(!is_beyond, "{case}");
            // A write decided before the slew was lowered may arrive afterwards.
            let slewed = slew[0].max(slew[1]) * PERIOD.as_secs_f64();
            slew[0] = slew[1];
            for (i, window) in windows.iter_mut().enumerate() {
                let outside = window.goes(slewed, world.applied[i]);
                assert!(outside <= 1e-9, "{case}: axis {i} by {outside} mm");
            }
            if world.applied != before {
                assert!(world.interlocks.reasons().is_empty(), "{case}");
            }
        }
    }
}
