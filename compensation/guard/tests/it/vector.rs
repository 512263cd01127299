//! The correction of all axes as one vector: the limits hold in any cycle. The runtime's tests cover the effect on the
//! tool.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{AxisLimits, Limits, RequestedCorrection, Vector};
use volcomp_vocabulary::{AxisKind, PerChannel};

use crate::world::limits;

/// X, Y, Z, A and C: limits of 0.15 mm and 150 µrad, steps of 1 µm and 5 µrad.
pub(crate) fn five(accel_s: f64) -> Limits {
    let mut limits = limits();
    limits.count = 5;
    for (i, axis) in limits.axes.iter_mut().enumerate() {
        axis.accel_per_s2 = axis.slew_per_s / accel_s;
        if i >= 3 {
            *axis = AxisLimits {
                kind: AxisKind::Rotary,
                limit: 150e-6,
                warn: 100e-6,
                slew_per_s: 500e-6,
                accel_per_s2: 500e-6 / accel_s,
                resolution: 5e-6,
                ..*axis
            };
        }
    }
    limits
}

pub(crate) fn three() -> Limits {
    let mut limits = five(0.0);
    limits.count = 3;
    limits
}

pub(crate) fn of<const N: usize>(values: [f64; N]) -> PerChannel<f64> {
    PerChannel::leading(values)
}

/// If rounding exceeds the limit of a linear axis, the nearest steps within the limit are used; distances are measured
/// in the steps of each axis.
#[test]
fn rounding_at_a_limit_takes_the_nearest_steps() {
    for sign in [1.0, -1.0] {
        // Columns: step of C; shares of A and C in steps; movement of X per step of A and of C, mm; expected steps of A
        // and C.
        for (step, shares, by_step, expected) in [
            (5e-6, [10.7, 10.3], [0.1499 / 10.7, 0.0], [10.0, 10.0]),
            (5e-6, [10.7, 10.7], [0.1499 / 10.7, 0.0], [10.0, 11.0]),
            // 11 and 6 steps are beyond the limit of X. The steps 11 and 5 are 0.85 steps away, the steps 10 and 6 are
            // 1.15 steps away.
            (20e-6, [10.8, 5.65], [0.1499 / 16.45, 0.1499 / 16.45], [11.0, 5.0]),
        ] {
            let mut limits = five(0.0);
            limits.axes[4].resolution = step;
            let sizes = [5e-6, step];
            let [a, c] = [0, 1].map(|i| sign * shares[i] * sizes[i]);
            let mut requested = RequestedCorrection {
                rotary: of([0.0, 0.0, 0.0, a, c]),
                ..RequestedCorrection::default()
            };
            for i in [0, 1] {
                requested.follow[3 + i] = of([sign * by_step[i] / sizes[i]]);
            }
            let mut vector = Vector::default();
            for _ in 0..1000 {
                vector.follow(&requested, &limits, 0.004);
            }
            let steps = [0, 1].map(|i| (sign * vector.output()[3 + i] / sizes[i]).round());
            assert_eq!(steps, expected, "{sign} {step}");
        }
    }
}

/// The ramp time becomes ten times longer during the ramp: the axes brake together and stay on one straight line.
#[test]
fn a_ramp_that_slows_down_stays_on_its_line() {
    let mut limits = three();
    let request = [0.12, -0.06, 0.03];
    for (axis, accel_s) in limits.axes.iter_mut().zip([0.4, 0.1, 0.2]) {
        axis.accel_per_s2 = axis.slew_per_s / accel_s;
    }
    let requested = RequestedCorrection::linear(of(request));
    let mut vector = Vector::default();
    let mut slowed = false;
    for cycle in 0..3000 {
        slowed |= vector.smooth()[0] > 0.5 * request[0];
        limits.ramp = core::time::Duration::from_millis(if slowed { 4000 } else { 400 });
        let result = vector.follow(&requested, &limits, 0.004);
        assert!(!result.behind, "{cycle}");
        let smooth = vector.smooth();
        for i in [1, 2] {
            let expected = smooth[0] * request[i] / request[0];
            assert!((smooth[i] - expected).abs() < 1e-12, "{cycle}: {smooth:?}");
        }
    }
    assert!(slowed && vector.is_ramped());
}

/// A random request as of a wrong model: any shares, and levers up to 0.6 m.
fn any_request() -> impl Strategy<Value = RequestedCorrection> {
    let share = |size: f64| -size..size;
    let row = move || [share(600.0), share(600.0), share(600.0)];
    ([share(0.3), share(0.3), share(0.3)], [share(400e-6), share(400e-6)], [row(), row()]).prop_map(
        |([x, y, z], [a, c], [by_a, by_c])| {
            let mut follow = PerChannel::default();
            (follow[3], follow[4]) = (of(by_a), of(by_c));
            RequestedCorrection {
                position: of([x, y, z]),
                rotary: of([0.0, 0.0, 0.0, a, c]),
                follow,
            }
        },
    )
}

/// A motion of a vector, and its number of cycles.
#[derive(Clone, Debug)]
enum Task {
    Follow(RequestedCorrection, usize),
    Ramp(RequestedCorrection, usize),
    Line([f64; 5], usize),
    Stop,
    At([f64; 5]),
}

fn any_task() -> impl Strategy<Value = Task> {
    let places = || {
        let linear = || -0.15..0.15_f64;
        let rotary = || -150e-6..150e-6_f64;
        (linear(), linear(), linear(), rotary(), rotary())
            .prop_map(|(x, y, z, a, c)| [x, y, z, a, c])
    };
    prop_oneof![
        4 => (any_request(), 1..60_usize).prop_map(|(requested, cycles)| Task::Follow(requested, cycles)),
        2 => (any_request(), 1..60_usize).prop_map(|(requested, cycles)| Task::Ramp(requested, cycles)),
        1 => (Just([0.0; 5]), 1..80_usize).prop_map(|(to, cycles)| Task::Line(to, cycles)),
        1 => (places(), 1..80_usize).prop_map(|(to, cycles)| Task::Line(to, cycles)),
        1 => Just(Task::Stop),
        1 => places().prop_map(Task::At),
    ]
}

/// Runs tasks. In every cycle `cycle_seen` receives the vector before and after, the cycle time, and whether the rate
/// was reset.
fn run(
    tasks: &[Task],
    dts: &[f64],
    limits: &Limits,
    mut cycle_seen: impl FnMut(&Vector, &Vector, f64, bool) -> Result<(), TestCaseError>,
) -> Result<Vector, TestCaseError> {
    let mut vector = Vector::default();
    let mut stopped = true;
    let mut count = 0;
    for task in tasks {
        let cycles = match task {
            Task::Follow(_, cycles) | Task::Ramp(_, cycles) | Task::Line(_, cycles) => *cycles,
            Task::Stop | Task::At(_) => 0,
        };
        match task {
            Task::Follow(..) => (),
            Task::Ramp(..) => vector.begin_ramp(),
            Task::Line(to, _) => vector.begin_line(&of(*to)),
            Task::Stop => vector.stop(),
            Task::At(place) => vector = Vector::at(&of(*place)),
        }
        stopped |= cycles == 0;
        for _ in 0..cycles {
            let (dt, before) = (dts[count % dts.len()], vector);
            count += 1;
            match task {
                Task::Follow(requested, _) | Task::Ramp(requested, _) => {
                    vector.follow(requested, limits, dt);
                }
                _ => {
                    vector.advance_line(limits, dt);
                }
            }
            cycle_seen(&before, &vector, dt, stopped)?;
            stopped = false;
        }
    }
    Ok(vector)
}

proptest! {
    /// Slew, acceleration and limit hold in every cycle and time window, with cycle times from a third of the period to five periods.
    #[test]
    fn slew_acceleration_and_limit_hold(
        tasks in prop::collection::vec(any_task(), 1..10),
        dts in prop::collection::vec(prop_oneof![Just(0.004), 0.001..0.020_f64], 50),
        accel_s in prop_oneof![Just(0.0), 0.01..1.0_f64],
    ) {
        let limits = five(accel_s);
        let mut rate = PerChannel::ZERO;
        let mut time = 0.0;
        // Words since the last jump to a confirmed value.
        let mut trace: Vec<(f64, PerChannel<f64>)> = Vec::new();
        run(&tasks, &dts, &limits, |before, after, dt, stopped| {
            if stopped {
                rate = PerChannel::ZERO;
                trace = vec![(time, before.output())];
            }
            time += dt;
            for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
                let now = (after.smooth()[i] - before.smooth()[i]) / dt;
                prop_assert!(now.abs() <= axis.slew_per_s * (1.0 + 1e-9), "{now}");
                let most = axis.accel_per_s2 * dt * (1.0 + 1e-6) + 1e-6 * axis.slew_per_s;
                prop_assert!((now - rate[i]).abs() <= most, "{} to {now} in {dt} {before:?} {after:?}", rate[i]);
                rate[i] = now;
                prop_assert!(after.smooth()[i].abs() <= axis.limit * (1.0 + 1e-9));
                prop_assert!(after.output()[i].abs() <= axis.limit * (1.0 + 1e-9));
                let steps = after.output()[i] / axis.resolution;
                let on_grid = (steps - steps.round()).abs() < 1e-6;
                prop_assert!(on_grid || after.output()[i] == before.output()[i]);
                let away = (after.output()[i] - after.smooth()[i]).abs() / axis.resolution;
                prop_assert!(away <= 0.6 + 1e-6, "{away}");
            }
            trace.push((time, after.output()));
            let (end, to) = trace[trace.len() - 1];
            for (start, from) in &trace {
                for (i, axis) in limits.axes.iter().enumerate().take(limits.count) {
                    let most = axis.slew_per_s * (end - start) + axis.resolution;
                    prop_assert!((to[i] - from[i]).abs() <= most * (1.0 + 1e-9));
                }
            }
            Ok(())
        })?;
    }

    /// Limit, slew and acceleration are lowered in motion: no axis moves farther out than before or than the new limit,
    /// and the return uses the lower slew.
    #[test]
    fn lowered_limits_are_not_exceeded(
        before in prop::collection::vec(any_task(), 1..5),
        after in prop::collection::vec(any_request(), 1..5),
        parts in prop::array::uniform3(prop_oneof![Just(1.0), 0.02..1.0_f64]),
        accel_s in prop_oneof![Just(0.0), 0.01..1.0_f64],
        dts in prop::collection::vec(prop_oneof![Just(0.004), 0.001..0.020_f64], 50),
        line in any::<bool>(),
    ) {
        let old = five(accel_s);
        let mut vector = run(&before, &dts, &old, |_, _, _, _| Ok(()))?;
        let mut new = old;
        for axis in new.axes.iter_mut().take(5) {
            axis.limit = (axis.limit * parts[0]).max(axis.resolution);
            axis.warn = 0.0;
            axis.slew_per_s *= parts[1];
            axis.accel_per_s2 *= parts[2];
        }
        if line {
            vector.begin_line(&PerChannel::ZERO);
        }
        for requested in &after {
            for dt in &dts {
                let before = vector;
                if line {
                    vector.advance_line(&new, *dt);
                } else {
                    vector.follow(requested, &new, *dt);
                }
                for (i, axis) in new.axes.iter().enumerate().take(5) {
                    let rounding = 1e-6 * axis.resolution;
                    let (stood, stands) = (before.smooth()[i], vector.smooth()[i]);
                    prop_assert!(stands.abs() <= axis.limit.max(stood.abs()) + rounding);
                    let (stood_word, word) = (before.output()[i], vector.output()[i]);
                    prop_assert!(word.abs() <= axis.limit.max(stood_word.abs()) + rounding);
                    let rate = (stands - stood).abs() / dt;
                    prop_assert!(rate <= axis.slew_per_s * (1.0 + 1e-9), "{rate}");
                }
            }
        }
        // In the end every word is within the new limit.
        for _ in 0..3000 {
            vector.follow(&RequestedCorrection::default(), &new, 0.02);
        }
        for (i, axis) in new.axes.iter().enumerate().take(5) {
            prop_assert!(vector.output()[i].abs() <= axis.limit * (1.0 + 1e-9), "{vector:?}");
        }
    }

    /// Unless the axes are reported as behind, the linear words match the current rotary shares.
    #[test]
    fn linear_axes_follow_the_moving_shares(
        requested in any_request(),
        accel_s in prop_oneof![Just(0.0), 0.01..1.0_f64],
        dts in prop::collection::vec(prop_oneof![Just(0.004), 0.001..0.020_f64], 50),
    ) {
        let mut limits = five(accel_s);
        let full = requested.full();
        for (i, axis) in limits.axes.iter_mut().enumerate().take(5) {
            axis.limit = full[i].abs() + requested.position[i].abs() + 0.02;
        }
        let mut vector = Vector::default();
        for cycle in 0..6_000 {
            let followed = vector.follow(&requested, &limits, dts[cycle % dts.len()]);
            prop_assert!(!followed.limited);
            // One factor reduces all position shares during a ramp: without the motion that follows the rotary axes,
            // the linear shares are proportional to the position share.
            let rotary = PerChannel::from_fn(|i| if i >= 3 { vector.smooth()[i] } else { 0.0 });
            let following = RequestedCorrection { position: PerChannel::ZERO, rotary, ..requested }.full();
            let beside = |i: usize| vector.smooth()[i] - following[i];
            let (x, y) = (requested.position[0], requested.position[1]);
            if !followed.behind {
                prop_assert!((beside(0) * y - beside(1) * x).abs() < 1e-8 * 0.3, "{vector:?}");
            }
            if vector.is_ramped() && !followed.slewing && cycle > 5_000 {
                prop_assert!((beside(0) - x).abs() < 1e-6, "{vector:?}");
            }
        }
        prop_assert!(vector.is_ramped());
        for (i, axis) in limits.axes.iter().enumerate().take(5).skip(3) {
            prop_assert!((vector.output()[i] - full[i]).abs() <= 0.6001 * axis.resolution);
        }
    }

    /// Without rotary axes a request within the slew is reached in every cycle up to the rounding.
    #[test]
    fn three_axes_reach_their_request(
        at in prop::array::uniform3(-0.1..0.1_f64),
        rates in prop::array::uniform3(-0.45..0.45_f64),
        dts in prop::collection::vec(0.001..0.020_f64, 200),
    ) {
        let limits = three();
        let mut vector = Vector::default();
        let mut now = at;
        for cycle in 0..2000 {
            let dt = dts[cycle % dts.len()];
            if vector.is_ramped() {
                for (now, rate) in now.iter_mut().zip(rates) {
                    let next = *now + rate * dt;
                    *now = if next.abs() < 0.14 { next } else { *now };
                }
            }
            let followed = vector.follow(&RequestedCorrection::linear(of(now)), &limits, dt);
            prop_assert!(!followed.limited && !followed.slewing, "{followed:?}");
            if vector.is_ramped() {
                for (i, now) in now.iter().enumerate() {
                    prop_assert!((vector.output()[i] - now).abs() <= 0.0006 + 1e-9);
                }
            }
        }
        prop_assert!(vector.is_ramped());
    }

    /// At standstill noise below the hysteresis changes a rotary word at most once, a linear word at most three times.
    #[test]
    fn no_chatter_at_standstill(
        requested in any_request(),
        noise in prop::collection::vec(prop::array::uniform5(-0.00004..0.00004_f64), 200),
    ) {
        let limits = five(0.0);
        let mut vector = Vector::default();
        // The request is within the limits, so that no factor changes with the noise.
        let requested = RequestedCorrection {
            position: requested.position.map(|x| 0.1 * x),
            rotary: requested.rotary.map(|x| 0.1 * x),
            ..requested
        };
        for _ in 0..4000 {
            vector.follow(&requested, &limits, 0.004);
        }
        let mut changes = [0; 5];
        for noise in noise {
            let mut noisy = requested;
            for (i, noise) in noise.into_iter().enumerate() {
                if i < 3 {
                    noisy.position[i] += noise;
                } else {
                    noisy.rotary[i] += 5e-3 * noise;
                }
            }
            let before = vector.output();
            for _ in 0..5 {
                vector.follow(&noisy, &limits, 0.004);
            }
            for (i, changes) in changes.iter_mut().enumerate() {
                *changes += u32::from(vector.output()[i] != before[i]);
            }
        }
        // A rotary word may change once. A linear word may change with each of the two rotary words, and once more.
        prop_assert!(changes[3] <= 1 && changes[4] <= 1, "{changes:?}");
        prop_assert!(changes[..3].iter().all(|changes| *changes <= 3), "{changes:?}");
    }
}

#[test]
fn nan_and_infinity_move_nothing() {
    let limits = five(0.0);
    let here = of([0.020, 0.030, -0.040, -40e-6, 35e-6]);
    let mut follow = PerChannel::default();
    follow[3] = of([0.0, f64::NAN]);
    for requested in [
        RequestedCorrection::linear(of([f64::NAN])),
        RequestedCorrection::linear(of([f64::INFINITY])),
        RequestedCorrection { follow, ..RequestedCorrection::default() },
    ] {
        let mut vector = Vector::at(&here);
        assert!(vector.follow(&requested, &limits, 0.004).slewing);
        assert_eq!(vector.output(), here);
    }
    for dt in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let mut vector = Vector::at(&here);
        vector.follow(&RequestedCorrection::default(), &limits, dt);
        vector.begin_line(&PerChannel::ZERO);
        assert!(!vector.advance_line(&limits, dt));
        vector.begin_line(&of([f64::NAN]));
        assert!(!vector.advance_line(&limits, 0.004));
        assert_eq!(vector.output(), here);
    }
    assert_eq!(Vector::at(&PerChannel::ZERO), Vector::default());
}

/// 20 cycles after one absurd request the axes are within one cycle of the ramp of their positions without this
/// request, and the ramp continues.
#[test]
fn one_absurd_request_does_not_end_the_ramp() {
    let requested = RequestedCorrection {
        rotary: of([0.0, 0.0, 0.0, 100e-6, -80e-6]),
        follow: {
            let mut follow = PerChannel::default();
            (follow[3], follow[4]) = (of([300.0, -100.0, 50.0]), of([20.0, 200.0, -80.0]));
            follow
        },
        ..RequestedCorrection::linear(of([0.070, -0.050, 0.030]))
    };
    let absurd = |size: f64| RequestedCorrection {
        position: requested.position.map(|x| -size * x),
        rotary: requested.rotary.map(|x| size * x),
        follow: requested.follow.map(|row| row.map(|x| size * x)),
    };
    let position = |size: f64| RequestedCorrection {
        position: requested.position.map(|x| -size * x),
        ..requested
    };
    for accel_s in [0.0, 0.1] {
        let mut limits = five(accel_s);
        limits.ramp = std::time::Duration::from_secs(1);
        for axis in limits.axes.iter_mut().take(5) {
            axis.resolution *= 0.01;
        }
        for disturbed in [2.5, 30.0, 1e6, 1e300].map(|size| [absurd(size), position(size)]) {
            for disturbed in disturbed {
                for at in [1, 2, 20, 125, 200] {
                    let [mut calm, mut vector] = [Vector::default(); 2];
                    for cycle in 0..400 {
                        calm.follow(&requested, &limits, 0.004);
                        let now = if cycle == at { &disturbed } else { &requested };
                        vector.follow(now, &limits, 0.004);
                        let differs = |i: usize| (vector.smooth()[i] - calm.smooth()[i]).abs();
                        let now = (0..3).map(differs).fold(0.0, f64::max);
                        // At most twice the slew for 20 cycles, then one cycle of the ramp.
                        let most = if cycle < at + 20 { 0.004 } else { 0.001 };
                        assert!(now <= most, "{accel_s} {at} {disturbed:?}: {now} in {cycle}");
                    }
                    assert!(vector.is_ramped());
                }
            }
        }
    }
}

/// After one absurd request the moving axes brake, and the ramp to zero begins in the next cycle.
#[test]
fn one_absurd_request_does_not_block_a_line() {
    for accel_s in [0.0, 0.1] {
        let limits = five(accel_s);
        for size in [30.0, 1e6, 1e12, 1e300] {
            let requested = |size: f64| RequestedCorrection {
                rotary: of([0.0, 0.0, 0.0, size * 60e-6, -size * 50e-6]),
                follow: {
                    let mut follow = PerChannel::default();
                    follow[3] = of([size * 300.0, -size * 100.0, size * 50.0]);
                    follow
                },
                ..RequestedCorrection::linear(of([size * 0.070, -size * 0.050, size * 0.030]))
            };
            for at in [20, 125, 400] {
                let mut vector = Vector::default();
                for _ in 0..at {
                    vector.follow(&requested(1.0), &limits, 0.004);
                }
                vector.follow(&requested(size), &limits, 0.004);
                vector.begin_line(&PerChannel::ZERO);
                let most = vector.time_to_zero(&limits).as_secs_f64() + 1.0;
                let mut time_s = 0.0;
                while !vector.advance_line(&limits, 0.004) {
                    time_s += 0.004;
                    assert!(time_s <= most, "{accel_s} {size} {at}: {vector:?}");
                }
            }
        }
    }
}

#[test]
fn a_limit_scales_every_share_equally() {
    let limits = three();
    let mut vector = Vector::default();
    let mut followed = vector.follow(&RequestedCorrection::default(), &limits, 0.004);
    assert!(!followed.limited && !followed.warned);
    for _ in 0..1000 {
        followed =
            vector.follow(&RequestedCorrection::linear(of([0.300, -0.100, 0.020])), &limits, 0.004);
    }
    assert_eq!(vector.output(), of([0.150, -0.050, 0.010]));
    assert!(followed.limited && followed.warned && !followed.slewing);
}

/// At rest the rotary values before rounding are whole output steps, and the linear words are solved for these values.
/// Otherwise the tip would be off if rounding exceeds the limit of a linear axis.
#[test]
fn at_rest_rotary_words_are_whole_steps() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut limits = five(0.0);
    for axis in limits.axes.iter_mut().take(5) {
        axis.slew_per_s *= 10.0;
    }
    limits.ramp = std::time::Duration::from_millis(80);
    let (mut rested, mut whole) = (0, 0);
    for _ in 0..4000 {
        let mut requested = RequestedCorrection::default();
        for i in 0..3 {
            limits.axes[i].limit = rng.random_range(0.02..0.12);
            requested.position[i] = rng.random_range(-0.1..0.1);
        }
        for r in 3..5 {
            limits.axes[r].limit = 300e-6;
            limits.axes[r].resolution = 17.453e-6;
            requested.rotary[r] = rng.random_range(-200e-6..200e-6);
            requested.follow[r] = of([(); 3].map(|()| rng.random_range(-400.0..400.0)));
        }
        let mut vector = Vector::default();
        for _ in 0..200 {
            vector.follow(&requested, &limits, 0.004);
        }
        let before = vector.smooth();
        let followed = vector.follow(&requested, &limits, 0.004);
        if before != vector.smooth() || followed.slewing {
            continue;
        }
        rested += 1;
        let [output, smooth] = [vector.output(), vector.smooth()];
        let beside = |r: usize| (output[r] - smooth[r]).abs() / limits.axes[r].resolution;
        assert!(beside(3) < 1e-6 && beside(4) < 1e-6, "{requested:?} {vector:?}");
        whole += u32::from(output[3] != 0.0 || output[4] != 0.0);
    }
    assert!(rested > 3900 && whole > 1500, "{rested} {whole}");
}
