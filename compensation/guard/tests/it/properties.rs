//! Random faults over thousands of cycles: nothing may ever leave its bounds, and a seed makes one trace.

use std::time::Duration;

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{Limits, Reasons, Request, State};
use volcomp_vocabulary::{MAX_AXES, PerChannel};

use crate::world::{STEP, World, axes, limits};

/// One of the things that happen.
fn happens(world: &mut World, random: &mut ChaCha8Rng) -> (Option<Request>, bool) {
    let mut request = None;
    let mut cleared = false;
    match random.random_range(0..60) {
        0 => world.answers ^= true,
        1 => world.emergency_stop ^= true,
        2 => world.alarm ^= true,
        3 => world.referenced ^= true,
        4 => world.frozen_at = world.frozen_at.xor(Some(world.now)),
        5 => {
            world.target = Some(axes(
                random.random_range(-0.3..0.3),
                random.random_range(-0.3..0.3),
            ));
        }
        6 => world.target = Some(axes(f64::NAN, 0.0)),
        7 => world.target = None,
        8 => world.positions[0] = f64::INFINITY,
        9 => world.positions[0] = random.random_range(-1e3..1e3),
        10 => {
            world.applied = PerChannel::ZERO;
            cleared = true;
        }
        11 => {
            let steps = |random: &mut ChaCha8Rng| f64::from(random.random_range(-100..100)) * STEP;
            world.applied = axes(steps(random), steps(random));
            cleared = true;
        }
        12 => request = Some(Request::Disarm),
        13 => request = Some(Request::Switched),
        14 => request = Some(Request::Acknowledge),
        15 => {
            world.forbids = if world.forbids.is_empty() {
                Reasons::AUDIT
            } else {
                Reasons::NONE
            }
        }
        16 => world.sticks ^= true,
        17 => world.really_includes ^= true,
        18..30 => request = Some(Request::Arm),
        30..34 => {
            (
                world.answers,
                world.emergency_stop,
                world.alarm,
                world.referenced,
            ) = (true, false, false, true);
            (world.frozen_at, world.positions[0], world.sticks) = (None, 0.0, true);
        }
        _ => {}
    }
    (request, cleared)
}

/// What was on the axes, cycle by cycle: time, applied, whether the world changed it.
fn trace(seed: u64, includes: bool, asked: bool) -> Vec<(f64, PerChannel<f64>, bool, State, u64)> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    // One write that was lost is noticed before the next.
    let mut limits = Limits {
        read_back_cycles: 1,
        ..limits()
    };
    if random.random() {
        limits.test_shift = PerChannel([5.0 * STEP; MAX_AXES]);
    }
    for axis in &mut limits.axes {
        axis.includes_correction = includes;
    }
    let mut world = World::new(&limits);
    (world.really_includes, world.tells_applied) = (includes, asked);
    let mut trace = Vec::new();
    for cycle in 0..4000 {
        let (request, cleared) = if cycle % 20 == 0 {
            happens(&mut world, &mut random)
        } else {
            (None, false)
        };
        let dt = Duration::from_micros(
            random.random_range(3000..5000) + 40_000 * u64::from(random.random_range(0..300) == 0),
        );
        // Without being asked a controller cannot tell that it was cleared.
        let cleared = cleared && asked;
        let before = world.applied;
        let output = world.cycle_after(dt, request);
        let changed = cleared || before != output.correction && !output.write;
        trace.push((
            world.now.as_secs_f64(),
            world.applied,
            changed,
            output.state,
            output.reasons.bits(),
        ));
    }
    trace
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn nothing_leaves_its_bounds(seed: u64, includes: bool) {
        let limits = limits();
        let trace = trace(seed, includes, true);
        for axis in 0..2 {
            // Upper and lower envelope of what may be on the axis since the world touched it last.
            let mut since = 0;
            for index in 1..trace.len() {
                let (now, applied, changed, ..) = trace[index];
                if changed {
                    since = index;
                    continue;
                }
                let value = applied[axis];
                prop_assert!(value.is_finite());
                let before = trace[index - 1].1[axis];
                let grew = value.abs() > before.abs() + 1e-12;
                prop_assert!(!grew || value.abs() <= limits.axes[axis].limit + 1e-9, "{value} at {index}");
                // Every window of a second.
                for (then, was, ..) in trace[since..index].iter().rev().take(250) {
                    let allowed = limits.axes[axis].slew_per_s * (now - then) + STEP + 1e-9;
                    prop_assert!((value - was[axis]).abs() <= allowed, "{} to {value} in {}", was[axis], now - then);
                }
            }
        }
    }

    #[test]
    fn a_seed_makes_one_trace(seed: u64, asked: bool) {
        prop_assert_eq!(trace(seed, false, asked), trace(seed, false, asked));
    }
}

/// The properties above are about something: all states are visited.
#[test]
fn random_faults_visit_every_state() {
    let mut seen = std::collections::BTreeSet::new();
    for seed in 0..30 {
        seen.extend(
            trace(seed, false, true)
                .iter()
                .map(|(_, _, _, state, _)| state.name()),
        );
    }
    let all = [
        "arming",
        "compensating",
        "disarmed",
        "faulted",
        "holding",
        "ramping-out",
    ];
    assert_eq!(seen.into_iter().collect::<Vec<_>>(), all);
}

proptest! {
    /// However fast slew and ramp allow, after k cycles no more than k twentieths of the way are gone: in, out, and to
    /// another target.
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
