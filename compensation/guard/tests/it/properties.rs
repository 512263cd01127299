//! Random faults over thousands of cycles: nothing may ever leave its bounds, and a seed makes one trace.

use std::time::Duration;

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::{Limits, Reasons, Request, Scheme, State};
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
            world.clear(PerChannel::ZERO);
            cleared = true;
        }
        11 => {
            let steps = |random: &mut ChaCha8Rng| f64::from(random.random_range(-100..100)) * STEP;
            let left = axes(steps(random), steps(random));
            world.clear(left);
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
        16 => {
            world.sticks ^= true;
            // Lines do not tell that a write was lost unless it fails.
            world.write_fails = random.random() || world.known().scheme == Scheme::NoReadBack;
        }
        19 => world.hides_applied ^= true,
        17 => world.really_includes ^= true,
        20..30 => request = Some(Request::Arm),
        30..34 => {
            (
                world.answers,
                world.emergency_stop,
                world.alarm,
                world.referenced,
            ) = (true, false, false, true);
            (world.frozen_at, world.positions[0], world.sticks) = (None, 0.0, true);
            (world.write_fails, world.hides_applied) = (false, false);
        }
        _ => {}
    }
    (request, cleared)
}

/// How the control is reached.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    Plain,
    Lines,
    Barrier,
}

/// What was on the axes, cycle by cycle.
#[derive(Clone, Debug, PartialEq)]
struct Moment {
    at_s: f64,
    applied: PerChannel<f64>,
    /// The world changed it, not the guard.
    changed: bool,
    state: State,
    reasons: u64,
    /// The largest change of an axis by one write or in one scan.
    step: f64,
}

fn trace(seed: u64, includes: bool, way: Way) -> Vec<Moment> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut limits = Limits {
        read_back_cycles: random.random_range(1..6),
        ..limits()
    };
    if random.random() {
        limits.test_shift = PerChannel([5.0 * STEP; MAX_AXES]);
    }
    for axis in &mut limits.axes {
        axis.includes_correction = includes;
    }
    let mut world = match way {
        Way::Plain => World::new(&limits),
        Way::Lines => World::lines(&limits),
        Way::Barrier => World::guarded(&limits),
    };
    world.really_includes = includes;
    let mut trace = Vec::new();
    for cycle in 0..4000 {
        let (request, cleared) = if cycle % 20 == 0 {
            happens(&mut world, &mut random)
        } else {
            (None, false)
        };
        // Only a control without a barrier, and that can be asked, may be moved from outside here.
        let cleared = cleared && way == Way::Plain;
        // Three equal lies in a row are what three equal readings are.
        let lied = std::mem::take(&mut world.lie).is_some();
        if !lied && random.random_range(0..50) == 0 {
            // One reading is torn, of another axis, or not a number.
            world.lie = Some(match random.random_range(0..4) {
                0 => axes(world.applied[1], world.applied[0]),
                1 => axes(world.applied[0] + 0.256, world.applied[1]),
                2 => axes(f64::NAN, 0.0),
                _ => axes(random.random_range(-70.0..70.0), 0.0),
            });
        }
        let dt = Duration::from_micros(
            random.random_range(3000..5000) + 40_000 * u64::from(random.random_range(0..300) == 0),
        );
        world.largest_step = 0.0;
        let (output, wrote) = if random.random_range(0..200) == 0 {
            // The program is stopped between reading and writing, and the control goes on meanwhile.
            world.freezes_between(dt, Duration::from_secs(2), request)
        } else {
            let before = world.applied;
            let output = world.cycle_after(dt, request);
            (output, before != world.applied)
        };
        trace.push(Moment {
            at_s: world.now.as_secs_f64(),
            applied: world.applied,
            changed: cleared && !wrote,
            state: output.state,
            reasons: output.reasons.bits(),
            step: if cleared { 0.0 } else { world.largest_step },
        });
    }
    trace
}

/// Principle 2 at the axis: no write moves an axis by more than the guard may without a barrier, no scan by more than the
/// barrier's rate; never beyond the limit but on the way in.
fn check(trace: &[Moment], way: Way) -> Result<(), TestCaseError> {
    let limits = limits();
    let axis = &limits.axes[0];
    let most = match way {
        // 2 counts a scan.
        Way::Barrier => 2.0 * STEP,
        Way::Plain | Way::Lines => (axis.slew_per_s * 0.004).max(STEP),
    };
    let mut since = 0;
    for index in 1..trace.len() {
        let now = &trace[index];
        if now.changed || trace[index - 1].changed {
            since = index;
            continue;
        }
        prop_assert!(now.step <= most + 1e-9, "a step of {} at {index}", now.step);
        for i in 0..2 {
            let (value, before) = (now.applied[i], trace[index - 1].applied[i]);
            prop_assert!(value.is_finite());
            let grew = value.abs() > before.abs() + 1e-12;
            prop_assert!(
                !grew || value.abs() <= axis.limit + 1e-9,
                "{value} at {index}"
            );
            // Every window of a second.
            for then in trace[since..index].iter().rev().take(250) {
                // A barrier moves by two steps in each of its scans.
                let (rate, least) = if way == Way::Barrier {
                    (1.0, 2.0 * STEP)
                } else {
                    (axis.slew_per_s, STEP)
                };
                let allowed = rate * (now.at_s - then.at_s) + least + 1e-9;
                prop_assert!(
                    (value - then.applied[i]).abs() <= allowed,
                    "{} to {value} in {} s",
                    then.applied[i],
                    now.at_s - then.at_s
                );
            }
        }
    }
    Ok(())
}

fn way() -> impl Strategy<Value = Way> {
    prop_oneof![Just(Way::Plain), Just(Way::Lines), Just(Way::Barrier)]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(cases()))]

    #[test]
    fn nothing_leaves_its_bounds(seed: u64, includes: bool, way in way()) {
        check(&trace(seed, includes, way), way)?;
    }
}

/// The properties above are about something: all states are visited.
#[test]
fn random_faults_visit_every_state() {
    for way in [Way::Plain, Way::Lines, Way::Barrier] {
        let mut seen = std::collections::BTreeSet::new();
        for seed in 0..30 {
            seen.extend(
                trace(seed, false, way)
                    .iter()
                    .map(|moment| moment.state.name()),
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
        assert_eq!(seen.into_iter().collect::<Vec<_>>(), all, "{way:?}");
    }
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

/// How many random sequences are tried: 96, or what `VOLCOMP_SEQUENCES` says.
fn cases() -> u32 {
    let asked = std::env::var("VOLCOMP_SEQUENCES");
    asked
        .ok()
        .and_then(|asked| asked.parse().ok())
        .unwrap_or(96)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(cases()))]

    /// Whatever happened: once all is well and a person disarms, the correction comes to zero.
    #[test]
    fn it_always_comes_to_rest(seed: u64, way in way()) {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let limits = Limits { read_back_cycles: random.random_range(1..6), ..limits() };
        let mut world = match way {
            Way::Plain => World::new(&limits),
            Way::Lines => World::lines(&limits),
            Way::Barrier => World::guarded(&limits),
        };
        for cycle in 0..1500 {
            let request = if cycle % 20 == 0 { happens(&mut world, &mut random).0 } else { None };
            let dt = Duration::from_micros(
                random.random_range(3000..5000) + 40_000 * u64::from(random.random_range(0..30) == 0),
            );
            world.cycle_after(dt, request);
        }
        (world.answers, world.emergency_stop, world.alarm, world.referenced) = (true, false, false, true);
        (world.frozen_at, world.positions[0], world.sticks) = (None, 0.0, true);
        (world.write_fails, world.hides_applied) = (false, false);
        world.run(Duration::from_secs(1));
        world.request(Request::Acknowledge);
        world.request(Request::Disarm);
        for _ in 0..1500 {
            let dt = Duration::from_micros(
                random.random_range(3000..5000) + 10_000 * u64::from(random.random_range(0..10) == 0),
            );
            world.cycle_after(dt, None);
        }
        prop_assert_eq!(world.guard.state(), State::Disarmed);
        prop_assert!(world.applied[0].abs() < 0.5 * STEP && world.applied[1].abs() < 0.5 * STEP);
    }
}
