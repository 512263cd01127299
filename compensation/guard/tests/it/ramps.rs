//! Ramps and lines: duration, start and end.

use std::time::Duration;

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{AxisLimits, Limits, Request, RequestedCorrection, State, Vector};
use volcomp_vocabulary::{AxisKind, PerChannel};

use crate::{
    vector::{five, of, three},
    world::{PERIOD, STEP, World, axes, limits},
};

fn line_s(limits: &Limits, from: &PerChannel<f64>, to: &PerChannel<f64>) -> f64 {
    let mut vector = Vector::at(from);
    vector.begin_line(to);
    for cycle in 1..100_000 {
        let arrived = vector.advance_line(limits, 0.004);
        let part = |i: usize| (vector.smooth()[i] - from[i]) / (to[i] - from[i]);
        for i in 1..limits.count {
            assert!((part(i) - part(0)).abs() < 1e-6, "{i}: {vector:?}");
        }
        if arrived {
            assert_eq!(vector.output(), *to);
            assert!(vector.advance_line(limits, 0.004), "it stays there");
            return 0.004 * f64::from(cycle);
        }
    }
    panic!("{vector:?}");
}

#[test]
fn a_line_takes_the_ramp_or_as_long_as_its_slowest_axis() {
    let from = of([0.100, -0.050, 0.020, 100e-6, -50e-6]);
    let to = of([0.0, 0.010, 0.0, 0.0, 0.0]);
    let limits = five(0.0);
    let ramp_s = line_s(&limits, &from, &to);
    assert!((ramp_s - 0.5).abs() < 0.005, "{ramp_s}");
    // 50 µrad at 50 µrad/s take 1 s.
    let mut slow = limits;
    slow.axes[4].slew_per_s = 50e-6;
    let slow_s = line_s(&slow, &from, &to);
    assert!((slow_s - 1.0).abs() < 0.01, "{slow_s}");
    // The axis needs 0.1 s to reach the slew of 0.1 mm/s.
    let mut eased = limits;
    eased.axes[0].slew_per_s = 0.1;
    eased.axes[0].accel_per_s2 = 1.0;
    let eased_s = line_s(&eased, &from, &to);
    assert!((1.09..1.3).contains(&eased_s), "{eased_s}");
    // The ramp has at least 20 cycles.
    let mut short = limits;
    short.ramp = Duration::ZERO;
    short.axes.iter_mut().for_each(|axis| axis.slew_per_s *= 10.0);
    let short_s = line_s(&short, &from, &to);
    assert!((short_s - 0.08).abs() < 0.005, "{short_s}");
}

/// The predicted time to zero equals that of the line, whether slew, acceleration or the minimum of 20 cycles limits it.
#[test]
fn the_predicted_time_to_zero_is_that_of_a_line() {
    for slew_per_s in [0.05, 0.4, 5.0] {
        for accel_per_s2 in [0.5, 10.0, 200.0, f64::INFINITY] {
            for x in [0.001, 0.020, 0.140] {
                let mut limits = five(0.0);
                limits.ramp = Duration::ZERO;
                for axis in &mut limits.axes {
                    if axis.kind == AxisKind::Linear {
                        (axis.slew_per_s, axis.accel_per_s2) = (slew_per_s, accel_per_s2);
                    }
                }
                let from = of([x, -0.6 * x, 0.3 * x, 20e-6, -10e-6]);
                let foretold_s = Vector::at(&from).time_to_zero(&limits).as_secs_f64();
                let mut vector = Vector::at(&from);
                vector.begin_line(&PerChannel::ZERO);
                let mut cycles = 1;
                while !vector.advance_line(&limits, 0.004) {
                    cycles += 1;
                }
                let taken_s = 0.004 * f64::from(cycles);
                let off_s = taken_s - foretold_s;
                let allowed_s = 0.012 + 0.03 * taken_s;
                assert!(
                    off_s.abs() <= allowed_s,
                    "{x} mm, {slew_per_s} mm/s, {accel_per_s2} mm/s²: {foretold_s} s, not {taken_s} s"
                );
            }
        }
    }
}

/// A line ends exactly at its goal, also from a value between output steps.
#[test]
fn a_correction_off_the_grid_goes_to_zero() {
    let limits = five(0.0);
    let mut vector = Vector::at(&of([0.0004, -0.1237, 0.0, 2.4e-6, 0.0]));
    assert_eq!(vector.output()[0], 0.0004);
    vector.begin_line(&PerChannel::ZERO);
    while !vector.advance_line(&limits, 0.004) {}
    assert_eq!(vector.output(), PerChannel::ZERO);
}

#[test]
fn a_ramp_takes_its_time_and_begins_at_the_present_correction() {
    let limits = five(0.0);
    let mut follow = PerChannel::default();
    follow[3] = of([0.0, 200.0, -100.0]);
    let requested = RequestedCorrection {
        position: of([0.030, -0.020, 0.010]),
        rotary: of([0.0, 0.0, 0.0, 50e-6]),
        follow,
    };
    for from in [PerChannel::ZERO, of([0.020, 0.030, -0.040, -40e-6, 35e-6])] {
        let mut vector = Vector::at(&from);
        let mut cycles = 0;
        while !vector.is_ramped() {
            let before = vector.smooth();
            let followed = vector.follow(&requested, &limits, 0.004);
            assert!(!followed.slewing, "{followed:?}");
            cycles += 1;
            for i in 0..5 {
                let most = (requested.full()[i] - from[i]).abs() / 120.0 + 1e-6;
                assert!((vector.smooth()[i] - before[i]).abs() <= most);
            }
        }
        assert!((124..=126).contains(&cycles), "{cycles}");
        for i in 0..5 {
            let step = limits.axes[i].resolution;
            assert!((vector.output()[i] - requested.full()[i]).abs() < 0.51 * step);
        }
    }
}

/// If one axis needs two seconds at its slew, all axes take two seconds, and the ramp is reported as slewing.
#[test]
fn a_ramp_that_is_too_fast_for_an_axis_is_slower_for_all() {
    let mut limits = three();
    limits.axes[1].slew_per_s = 0.010;
    let mut vector = Vector::default();
    let mut cycles = 0;
    while !vector.is_ramped() {
        let followed =
            vector.follow(&RequestedCorrection::linear(of([0.1, 0.02, -0.05])), &limits, 0.004);
        let [x, y, z, ..] = vector.smooth().0;
        assert!((x - 5.0 * y).abs() < 1e-9 && (z + 2.5 * y).abs() < 1e-9);
        assert!(!followed.behind && (followed.slewing || vector.is_ramped()));
        cycles += 1;
    }
    assert!((499..=502).contains(&cycles), "{cycles}");
}

/// The last rate of a line is the start rate of the next motion: the change of rate stays within the acceleration.
#[test]
fn a_motion_after_a_line_starts_with_its_last_rate() {
    let limits = five(0.118);
    let requested = RequestedCorrection::linear(of([0.260, 0.0, 0.0]));
    for from_um in 1..150_u32 {
        for dt in [0.004, 0.0013, 0.020] {
            let mut vector = Vector::at(&of([f64::from(from_um) * 1e-3, -0.004, 0.0]));
            vector.begin_line(&PerChannel::ZERO);
            let mut rates = PerChannel::ZERO;
            let mut moves = |vector: &mut Vector, on_line: bool| {
                let before = vector.smooth();
                let arrived = if on_line {
                    vector.advance_line(&limits, dt)
                } else {
                    vector.follow(&requested, &limits, dt);
                    false
                };
                for (i, axis) in limits.axes.iter().enumerate().take(3) {
                    let rate = (vector.smooth()[i] - before[i]) / dt;
                    let most = axis.accel_per_s2 * dt * (1.0 + 1e-9);
                    let change = (rate - rates[i]).abs();
                    assert!(change <= most, "{from_um} µm, {dt} s, {i}: {change} of {most}");
                    rates[i] = rate;
                }
                arrived
            };
            while !moves(&mut vector, true) {}
            vector.begin_ramp();
            for _ in 0..20 {
                moves(&mut vector, false);
            }
        }
    }
}

/// A single request of 20 mm at the start of a ramp has no effect after the ramp, which ends within 140 cycles.
#[test]
fn an_absurd_request_at_the_start_of_a_ramp_ends_with_the_ramp() {
    let mut linear = three();
    let mut rotary = five(0.0);
    for axis in linear.axes.iter_mut().chain(&mut rotary.axes).take(3) {
        axis.accel_per_s2 = 20.0;
    }
    rotary.axes[0].accel_per_s2 = 20.0;
    let right = |follow_mm: f64| {
        let mut follow = PerChannel::default();
        follow[3] = of([follow_mm]);
        RequestedCorrection { position: of([0.010]), rotary: of([0.0, 0.0, 0.0, 100e-6]), follow }
    };
    for from in [PerChannel::ZERO, of([0.020, 0.0, 0.0, 100e-6])] {
        for absurd in [1.0, 20.0, 1e3, 1e5, -1e12] {
            for (limits, requested, wrong) in [
                (
                    linear,
                    RequestedCorrection::linear(of([0.010])),
                    RequestedCorrection::linear(of([absurd])),
                ),
                // The levers are as wrong as the position.
                (
                    rotary,
                    right(100.0),
                    RequestedCorrection { position: of([absurd]), ..right(1e3 * absurd) },
                ),
            ] {
                let mut from = from;
                from[3] *= if limits.count > 3 { 1.0 } else { 0.0 };
                let mut vector = Vector::at(&from);
                vector.follow(&wrong, &limits, 0.004);
                let mut cycles = 1;
                while !vector.is_ramped() {
                    vector.follow(&requested, &limits, 0.004);
                    cycles += 1;
                    assert!(cycles <= 140, "{absurd}: {vector:?}");
                }
                let most = requested.full()[0];
                for _ in 0..25 {
                    vector.follow(&requested, &limits, 0.004);
                }
                assert!((vector.output()[0] - most).abs() < 0.001, "{absurd}: {vector:?}");
            }
        }
    }
}

/// During a ramp of 5 s the request for X exceeds its limit by 5 µm: Y continues its ramp at no more than 0.05 mm/s.
#[test]
fn a_request_beyond_a_limit_does_not_end_the_ramp_of_the_others() {
    let limits = Limits { ramp: Duration::from_secs(5), ..three() };
    let mut vector = Vector::at(&of([0.140, 0.0, 0.0]));
    vector.begin_ramp();
    let mut largest = 0.0_f64;
    for cycle in 0..500 {
        // The request increases by 0.2 µm per cycle.
        let x = (0.100 + 0.0002 * f64::from(cycle)).min(0.155);
        let before = vector.smooth()[1];
        vector.follow(&RequestedCorrection::linear(of([x, -0.120, 0.0])), &limits, 0.004);
        let rate = (vector.smooth()[1] - before).abs() / 0.004;
        largest = largest.max(rate);
    }
    // 120 µm in 5 s, with a margin because the limit reduces all shares.
    assert!(largest <= 0.05, "{largest} mm/s");
}

/// Tip error along X, Y, Z, mm: the linear axes compared with the values for the current A and C.
fn tip_misses(requested: &RequestedCorrection, at: &PerChannel<f64>) -> f64 {
    let off = |l: usize| {
        let follows = requested.follow[3][l] * at[3] + requested.follow[4][l] * at[4];
        at[l] - follows - requested.position[l]
    };
    (0..3).map(|l| off(l).powi(2)).sum::<f64>().sqrt()
}

/// A random five-axis request with levers up to 0.4 m.
fn any_request(random: &mut ChaCha8Rng) -> RequestedCorrection {
    let mut share = |size: f64| random.random_range(-size..size);
    let mut follow = PerChannel::default();
    for rotary in [3, 4] {
        follow[rotary] = of([share(400.0), share(400.0), share(400.0)]);
    }
    RequestedCorrection {
        position: of([share(0.2), share(0.2), share(0.2)]),
        rotary: of([0.0, 0.0, 0.0, share(300e-6), share(300e-6)]),
        follow,
    }
}

/// Limits and models change at random: unless an axis is reported as behind, the tip error exceeds neither the error
/// without correction nor the error at the start of the ramp, plus rounding.
#[test]
fn the_tip_error_never_exceeds_that_at_the_start_of_the_ramp() {
    for seed in 0..60_u64 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let mut limits = five(if random.random() { 0.0 } else { 0.05 });
        for axis in limits.axes.iter_mut().take(5) {
            axis.resolution = if axis.kind == AxisKind::Linear { 1e-5 } else { 1e-8 };
        }
        let mut requested = any_request(&mut random);
        let mut vector = Vector::default();
        let mut begun = tip_misses(&requested, &vector.smooth());
        for cycle in 0..3000 {
            let what = random.random_range(0..200);
            if what < 3 {
                match what {
                    0 => {
                        let [linear, rotary] =
                            [0.150, 150e-6].map(|most| most * random.random_range(0.02..1.0));
                        for axis in limits.axes.iter_mut().take(5) {
                            axis.limit = match axis.kind {
                                AxisKind::Linear => linear,
                                AxisKind::Rotary => rotary,
                            };
                            axis.warn = axis.limit;
                        }
                    }
                    1 => requested = any_request(&mut random),
                    _ => vector = Vector::at(&vector.smooth()),
                }
                vector.begin_ramp();
                begun = tip_misses(&requested, &vector.smooth());
            }
            let followed = vector.follow(&requested, &limits, 0.004);
            let off = tip_misses(&requested, &vector.smooth());
            let without = tip_misses(&requested, &PerChannel::ZERO);
            if followed.behind {
                begun = begun.max(off);
            } else {
                let most = begun.max(without) + 1e-4;
                assert!(off <= most, "seed {seed}, cycle {cycle}: {off} of {most}");
            }
        }
    }
}

/// A correction between two output steps ramps out, also if the slew per cycle is less than one step and the next step
/// is at the maximum distance of a word from the applied correction.
#[test]
fn a_correction_between_steps_ramps_out() {
    for seed in 0..2000 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let accel_s = if random.random_bool(0.5) { 0.0 } else { 0.02 };
        let mut limits = five(accel_s);
        for axis in limits.axes.iter_mut().take(5) {
            let steps_per_cycle = random.random_range(0.05..1.2);
            let slew_per_s = steps_per_cycle * axis.resolution / limits.period.as_secs_f64();
            axis.accel_per_s2 *= slew_per_s / axis.slew_per_s;
            axis.slew_per_s = slew_per_s;
        }
        let mut world = World::new(&limits);
        world.applied = PerChannel::from_fn(|i| {
            let steps = if random.random_bool(0.3) {
                1.0 + random.random_range(-0.1..0.1)
            } else {
                random.random_range(-5.0..5.0)
            };
            let is_there = i < limits.count && random.random_bool(0.8);
            f64::from(u8::from(is_there)) * steps * limits.axes[i].resolution
        });
        let left = world.applied;
        world.target = Some(left);
        world.run(10 * PERIOD);
        world.request(Request::Arm);
        world.run(random.random_range(1..100) * PERIOD);
        world.request(Request::Disarm);
        let out = world.run(Duration::from_secs(3));
        assert_eq!(out.state, State::Disarmed, "seed {seed}: {left:?}");
        for (axis, at) in limits.axes.iter().zip(&world.applied) {
            assert!(at.abs() <= 0.51 * axis.resolution, "seed {seed}: {left:?}");
        }
    }
}

#[test]
fn a_ramp_to_zero_ends_with_a_rotary_axis_already_at_zero() {
    let mut limits = limits();
    limits.count = 2;
    limits.axes[0].accel_per_s2 = f64::INFINITY;
    limits.axes[1] = AxisLimits {
        kind: AxisKind::Rotary,
        limit: 150e-6,
        warn: 100e-6,
        slew_per_s: 500e-6,
        accel_per_s2: 10e-3,
        resolution: 5e-6,
        ..limits.axes[1]
    };
    let mut world = World::new(&limits);
    (world.target, world.rotary[1]) = (Some(axes(0.080, 0.0)), 50e-6);
    let world = &mut world.arm();
    assert!((world.applied[1] - 50e-6).abs() < 1e-9);
    // The machine moves to a position where the rotary axis needs no correction.
    world.rotary[1] = 0.0;
    world.run(Duration::from_secs(4));
    assert_eq!(world.applied[1], 0.0);
    world.request(Request::Disarm);
    let out = world.run(Duration::from_secs(60));
    assert_eq!((out.state, world.applied[0]), (State::Disarmed, 0.0));
}

/// Duration of the ramp to a request beyond the limit, s; infinite after two minutes.
fn ramp_s(limit: f64, slew: f64, accel: f64, ramp: Duration, requested: [f64; 2]) -> f64 {
    let mut limits = limits();
    limits.ramp = ramp;
    for axis in &mut limits.axes {
        (axis.limit, axis.warn, axis.slew_per_s, axis.accel_per_s2) = (limit, limit, slew, accel);
    }
    let requested = RequestedCorrection::linear(axes(requested[0], requested[1]));
    let mut vector = Vector::default();
    for cycle in 1..=30_000_u32 {
        vector.follow(&requested, &limits, 0.004);
        if vector.is_ramped() {
            return f64::from(cycle) * 0.004;
        }
    }
    f64::INFINITY
}

/// The ramp to a request beyond the limit takes at most twice the ramp time, or twice the time that slew and
/// acceleration require for the whole request.
#[test]
fn the_ramp_to_a_request_beyond_a_limit_ends_in_time() {
    let mut wrong = 0;
    for limit in [0.030, 0.050, 0.100] {
        for slew in [0.05, 0.5] {
            for accel in [0.2, 2.0, 10.0, f64::INFINITY] {
                for ramp_ms in [100, 2000] {
                    for requested in [[0.040, 0.0], [0.186, 0.0], [0.186, -0.172], [0.060, 0.040]] {
                        let ramp = Duration::from_millis(ramp_ms);
                        let taken_s = ramp_s(limit, slew, accel, ramp, requested);
                        let most = requested[0].abs();
                        let alone_s = (most / slew + 2.0 * slew / accel)
                            .max(2.0 * (2.0 * most / accel).sqrt());
                        let allowed_s = 2.0 * ramp.as_secs_f64().max(alone_s) + 0.1;
                        if taken_s > allowed_s {
                            wrong += 1;
                            println!(
                                "limit {limit} slew {slew} accel {accel} ramp {ramp_ms} ms wanted {requested:?}: {taken_s} s, {allowed_s} s allowed"
                            );
                        }
                    }
                }
            }
        }
    }
    assert_eq!(wrong, 0);
}

proptest! {
    /// With any slew and ramp time, at most k/20 of the way is done after k cycles: ramping in, out, and to another target.
    #[test]
    fn a_ramp_is_never_steeper_than_twenty_cycles(from in -0.1..0.1_f64, to in -0.1..0.1_f64, ramp_ms in 0..400_u64, leave: bool) {
        let mut limits = Limits { ramp: Duration::from_millis(ramp_ms), ..limits() };
        for axis in &mut limits.axes {
            (axis.slew_per_s, axis.accel_per_s2) = (volcomp_guard::ceiling::SLEW_PER_S.0, f64::INFINITY);
        }
        let mut world = World::new(&limits);
        world.target = Some(axes(from, 0.0));
        world.request(Request::Arm);
        world.run(Duration::from_secs(1));
        let begun = world.applied[0];
        let (request, goal) = if leave { (Request::Disarm, 0.0) } else { (Request::Switched, to) };
        world.target = Some(axes(to, 0.0));
        let per_cycle = (0.004 / (ramp_ms as f64 * 1e-3).max(0.080)).min(0.05);
        for cycle in 1..=200 {
            world.cycle_after(Duration::from_millis(4), (cycle == 1).then_some(request));
            let gone = (world.applied[0] - begun).abs();
            let allowed = (goal - begun).abs() * (f64::from(cycle) * per_cycle).min(1.0) + 1.7 * STEP;
            prop_assert!(gone <= allowed, "{gone} of {} after {cycle}", goal - begun);
        }
        prop_assert!((world.applied[0] - goal).abs() <= 0.7 * STEP);
    }
}
