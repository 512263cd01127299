//! The ramp to zero, and limits that are lowered in motion.

use rand::RngExt;
use volcomp_vocabulary::PerChannel;

use super::{over_all_types, scene::Scene};

/// At standstill the tool stays between its initial and its uncorrected position.
#[test]
fn ramps_to_zero() {
    over_all_types("zero", 0.01, |cell, rng, seen| {
        let restarts = rng.random_bool(0.5);
        let mut scene = Scene::new(cell, rng, false, restarts);
        for _ in 0..rng.random_range(1..40) {
            scene.follow(rng, seen);
        }
        // Axes that were not where they belong together do not stop together.
        let together = !scene.followed.behind;
        scene.begins();
        scene.vector.begin_line(&PerChannel::ZERO);
        let state = scene.path.at(scene.time_s);
        for cycle in 0.. {
            let dt_s = scene.tick(rng);
            scene.time_s += dt_s;
            let before = scene.vector;
            let there = scene.vector.advance_line(&scene.limits, dt_s);
            scene.holds_words(&before, dt_s);
            if together {
                scene.judge(&state, seen);
            }
            seen.cycles += 1;
            if there {
                break;
            }
            assert!(cycle < 100_000, "it arrives");
        }
        assert_eq!(scene.vector.output(), PerChannel::ZERO);
        seen.arrived += 1;
    });
}

/// Limits, slew and acceleration: no word moves further out than before or than the new limit, the return takes the lower of both slews, and
/// afterwards the bound holds again.
#[test]
fn limits_lowered_in_motion() {
    over_all_types("lowered", 0.25, |cell, rng, seen| {
        let (moves, restarts) = (rng.random_bool(0.5), rng.random_bool(0.5));
        let mut scene = Scene::new(cell, rng, moves, restarts);
        for _ in 0..rng.random_range(1..40) {
            scene.follow(rng, seen);
        }
        let old = scene.limits;
        for axis in scene.limits.axes.iter_mut().take(old.count) {
            let mut part = || {
                if rng.random_bool(0.3) {
                    1.0
                } else {
                    rng.random_range(0.05..=1.5)
                }
            };
            axis.limit = (axis.limit * part()).max(2.0 * axis.resolution);
            axis.warn = axis.limit;
            axis.slew_per_s *= part();
            axis.accel_per_s2 *= part();
        }
        scene.vector.begin_ramp();
        for _ in 0..80 {
            let before = scene.vector;
            let dt_s = scene.tick(rng);
            scene.time_s += dt_s;
            // The ramp begins once what moved stands.
            if before.is_to_begin() {
                scene.begins();
            }
            let state = scene.path.at(scene.time_s);
            let wanted = scene.wanted(&state);
            scene.followed = scene.vector.follow(&wanted, &scene.limits, dt_s);
            for (i, axis) in scene.limits.axes.iter().enumerate().take(old.count) {
                let (smooth, stood) = (scene.vector.smooth()[i], before.smooth()[i]);
                let rounding = 1e-6 * axis.resolution;
                assert!(smooth.abs() <= axis.reachable().max(stood.abs()) + rounding);
                let (word, stood) = (scene.vector.output()[i], before.output()[i]);
                assert!(word.abs() <= axis.limit.max(stood.abs()) + rounding);
                let outside = before.smooth()[i].abs() > axis.reachable() + rounding;
                let slew = if outside {
                    axis.slew_per_s.min(old.axes[i].slew_per_s)
                } else {
                    axis.slew_per_s
                };
                let rate = (smooth - before.smooth()[i]).abs() / dt_s;
                assert!(rate <= slew * (1.0 + 1e-9), "{rate} of {slew}");
            }
            seen.cycles += 1;
            seen.slewing += usize::from(scene.followed.slewing);
            seen.behind += usize::from(scene.followed.behind);
            if !scene.followed.behind {
                scene.judge(&state, seen);
            }
        }
    });
}
