//! The parts of a correction, ramps to it and to zero, and limits lowered in motion.

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use volcomp_guard::RequestedCorrection;
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, MAX_AXES, PerAxis, PerChannel};

use super::{cell::Cell, over_all_types, scene::Scene};

/// The parts and the whole correction agree within 1e-12 (mm, rad), for every type of machine and any correcting axes.
#[test]
fn the_parts_add_up_to_the_correction() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    for structure in all_types() {
        for _ in 0..20 {
            let cell = Cell::new(&structure, &mut rng);
            let mut names = cell.model.axes.clone();
            names.shuffle(&mut rng);
            names.truncate(rng.random_range(1..=names.len()));
            for correctors in [cell.correctors.clone(), cell.model.correctors_among(&names)] {
                for _ in 0..20 {
                    let state = cell.random_state(&mut rng);
                    let whole = cell.model.correction_of(&state, &correctors);
                    let model = &cell.model;
                    let sum = |applied: &PerAxis<f64>| {
                        let wanted = model.wanted(&state, &correctors, applied);
                        PerAxis::from_fn(|i| {
                            let rows = wanted.follow.iter().zip(&wanted.rotary);
                            let following: f64 = rows.map(|(row, share)| row[i] * share).sum();
                            wanted.position[i] + following + wanted.rotary[i]
                        })
                    };
                    let first = sum(&PerAxis::ZERO);
                    let second = sum(&first);
                    let wanted = model.wanted(&state, &correctors, &first);
                    assert_eq!(
                        (wanted.singular, wanted.near_singular),
                        (whole.singular, whole.near_singular)
                    );
                    for i in 0..MAX_AXES {
                        let (sum, whole) = (second[i], whole.delta[i]);
                        assert!((sum - whole).abs() < 1e-12, "{structure}");
                    }
                }
            }
        }
    }
}

/// The bound holds on ramps at standstill and in motion: from zero, from any correction, and after a hold.
#[test]
fn ramps_to_the_correction() {
    for (name, behind, restarts, is_held) in
        [("ramp", 0.05, false, false), ("restart", 0.2, true, false), ("hold", 0.05, false, true)]
    {
        for moves in [false, true] {
            let name = format!("{name}, moves {moves}");
            over_all_types(&name, behind, |cell, rng, seen| {
                let mut scene = Scene::new(cell, rng, moves, restarts);
                if is_held {
                    for _ in 0..rng.random_range(1..60) {
                        scene.follow(rng, seen);
                    }
                    // Nothing is written while the machine continues to move.
                    scene.stands(rng.random_range(0.0..1.0));
                    scene.vector.begin_ramp();
                    scene.ramp_begins = true;
                }
                for _ in 0..60 {
                    scene.follow(rng, seen);
                }
                scene.holds_in_windows();
                seen.arrived += usize::from(scene.vector.is_ramped());
            });
        }
    }
}

/// With enough time and large enough limits the words reach the whole correction, within one step.
#[test]
fn arrives_at_the_whole_correction() {
    over_all_types("arrives", 0.03, |cell, rng, seen| {
        let mut scene = Scene::new(cell, rng, false, false);
        let whole = |input: &RequestedCorrection| cell.wanted(&scene.path.from, &input.full());
        let mut wanted = cell.wanted(&scene.path.from, &PerChannel::ZERO);
        for _ in 0..5 {
            wanted = whole(&wanted);
        }
        let full = wanted.full();
        for (i, axis) in scene.limits.axes.iter_mut().enumerate() {
            axis.limit = full[i].abs() + 3.0 * axis.resolution;
        }
        // The limits of the linear axes suffice to follow the rotary corrections as well.
        for (i, axis) in scene.limits.axes.iter_mut().enumerate() {
            axis.limit += wanted.position[i].abs() + 0.1;
        }
        let mut cycles = 0;
        loop {
            let before = scene.vector.smooth();
            scene.follow(rng, seen);
            let steps = scene.limits.axes.iter().map(|axis| axis.resolution);
            let mut ways = before.iter().zip(scene.vector.smooth()).zip(steps);
            let rests = ways.all(|((a, b), step)| (a - b).abs() < 1e-7 * step);
            if rests && scene.vector.is_ramped() && !scene.followed.slewing {
                break;
            }
            cycles += 1;
            assert!(cycles < 1_000_000, "{:?} {full:?}", scene.vector);
        }
        let [words, smooth] = [scene.vector.output(), scene.vector.smooth()];
        let rotary = PerChannel::from_fn(|i| match scene.limits.axes[i].kind {
            AxisKind::Rotary if i < scene.limits.count => words[i],
            _ => 0.0,
        });
        let there = scene.wanted(&scene.path.at(0.0));
        let exact = RequestedCorrection { rotary, ..there }.full();
        for (i, axis) in scene.limits.axes.iter().enumerate().take(scene.limits.count) {
            let close = 0.6001 * axis.resolution;
            match axis.kind {
                // Near a singular pose the request depends on the rounding of the axis positions. The word follows from
                // the actual position, and is within a step of the request at the unrounded position.
                AxisKind::Rotary => {
                    assert!((words[i] - there.rotary[i]).abs() <= close);
                    assert!((words[i] - full[i]).abs() <= axis.resolution);
                }
                AxisKind::Linear => assert!((words[i] - exact[i]).abs() <= close),
            }
            let rests = (smooth[i] - exact[i]).abs() <= 1e-4 * axis.resolution;
            assert!(rests, "{smooth:?} {exact:?}");
        }
        seen.arrived += 1;
    });
}

/// On a ramp to zero at standstill the tool error stays between its initial and its uncorrected value.
#[test]
fn ramps_to_zero() {
    over_all_types("zero", 0.01, |cell, rng, seen| {
        let restarts = rng.random_bool(0.5);
        let mut scene = Scene::new(cell, rng, false, restarts);
        for _ in 0..rng.random_range(1..40) {
            scene.follow(rng, seen);
        }
        // Lagging axes do not arrive together with the others.
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

/// Limits, slew and acceleration are lowered: no word moves farther out than before or than the new limit, the return uses the lower
/// slew, and then the bound holds again.
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
                if rng.random_bool(0.3) { 1.0 } else { rng.random_range(0.05..=1.5) }
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
            // The ramp begins when the moving axes have stopped.
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
