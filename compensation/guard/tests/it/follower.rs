//! One axis against its limits, with cycles of any length.

use proptest::prelude::*;
use volcomp_guard::{AxisLimits, Follower};

use crate::world::limits;

fn axis(accel: f64) -> AxisLimits {
    AxisLimits {
        accel_per_s2: accel,
        ..limits().axes[0]
    }
}

proptest! {
    /// Goals within the limit, cycles from 1 to 20 ms.
    #[test]
    fn slew_acceleration_and_clamp_hold(
        goals in prop::collection::vec((-0.15..0.15_f64, 1..60_usize), 1..20),
        dts in prop::collection::vec(0.001..0.020_f64, 50),
        accel in prop_oneof![Just(f64::INFINITY), 0.5..50.0_f64],
    ) {
        let limits = axis(accel);
        let mut follower = Follower::default();
        let (mut rate, mut smooth, mut cycle) = (0.0, 0.0, 0);
        // Extremes of smooth and output since each moment are bounded by these sums.
        let mut trace = vec![(0.0, 0.0)];
        let mut time = 0.0;
        for (goal, cycles) in goals {
            for _ in 0..cycles {
                let dt = dts[cycle % dts.len()];
                cycle += 1;
                time += dt;
                follower.follow(goal, &limits, dt);
                let now = (follower.smooth() - smooth) / dt;
                prop_assert!(now.abs() <= limits.slew_per_s + 1e-9);
                prop_assert!((now - rate).abs() <= accel * dt + 1e-6, "{rate} to {now} in {dt}");
                prop_assert!(follower.smooth().abs() <= 0.15 + 1e-9, "{}", follower.smooth());
                prop_assert!(follower.output().abs() <= 0.15 + 1e-9);
                (rate, smooth) = (now, follower.smooth());
                trace.push((time, follower.output()));
            }
        }
        for (start, a) in &trace {
            for (end, b) in &trace {
                prop_assert!((b - a).abs() <= limits.slew_per_s * (end - start).abs() + limits.resolution + 1e-9);
            }
        }
    }

    /// It arrives, and then stands.
    #[test]
    fn the_goal_is_reached(goal in -0.15..0.15_f64, accel in prop_oneof![Just(f64::INFINITY), 1.0..50.0_f64]) {
        let limits = axis(accel);
        let mut follower = Follower::default();
        for _ in 0..2000 {
            follower.follow(goal, &limits, 0.004);
        }
        prop_assert!((follower.smooth() - goal).abs() < 1e-4);
        prop_assert!((follower.output() - goal).abs() <= 0.6 * limits.resolution + 1e-4);
    }

    /// Noise of less than the hysteresis at standstill changes the output once at the most.
    #[test]
    fn no_chatter_at_standstill(place in -0.1..0.1_f64, noise in prop::collection::vec(-0.00009..0.00009_f64, 200)) {
        let limits = axis(f64::INFINITY);
        let mut follower = Follower::default();
        for _ in 0..500 {
            follower.follow(place, &limits, 0.004);
        }
        let mut changes = 0;
        for noise in noise {
            let before = follower.output();
            follower.follow(place + noise, &limits, 0.004);
            changes += u32::from(follower.output() != before);
        }
        prop_assert!(changes <= 1, "{changes}");
    }
}

#[test]
fn a_lowered_limit_is_approached_at_the_slew_rate() {
    let mut follower = Follower::at(0.120);
    let limits = AxisLimits {
        limit: 0.050,
        slew_per_s: 0.1,
        ..axis(f64::INFINITY)
    };
    let mut before = follower.output();
    for cycle in 1..=200 {
        follower.follow(0.050, &limits, 0.004);
        assert!((follower.output() - before).abs() <= 0.001 + 1e-9);
        before = follower.output();
        let expected = (0.120 - 0.1 * 0.004 * f64::from(cycle)).max(0.050);
        assert!((follower.smooth() - expected).abs() < 1e-9);
    }
    assert!((before - 0.050).abs() < 1e-9);
}
