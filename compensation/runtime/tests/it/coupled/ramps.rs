//! Ramps to what is wanted: at the start, in motion, after a hold, from any correction.

use rand::RngExt;
use volcomp_guard::RequestedCorrection;
use volcomp_vocabulary::{AxisKind, PerChannel};

use super::{over_all_types, scene::Scene};

#[test]
fn ramps_at_standstill_and_in_motion() {
    for moves in [false, true] {
        over_all_types(&format!("ramp, moves {moves}"), 0.05, |cell, rng, seen| {
            let mut scene = Scene::new(cell, rng, moves, false);
            for _ in 0..60 {
                scene.follow(rng, seen);
            }
            scene.holds_in_windows();
            seen.arrived += usize::from(scene.vector.is_ramped());
        });
    }
}

#[test]
fn restarts_in_mid_correction() {
    for moves in [false, true] {
        over_all_types(
            &format!("restart, moves {moves}"),
            0.2,
            |cell, rng, seen| {
                let mut scene = Scene::new(cell, rng, moves, true);
                for _ in 0..60 {
                    scene.follow(rng, seen);
                }
                scene.holds_in_windows();
                seen.arrived += usize::from(scene.vector.is_ramped());
            },
        );
    }
}

#[test]
fn held_and_restarted() {
    for moves in [false, true] {
        over_all_types(&format!("hold, moves {moves}"), 0.05, |cell, rng, seen| {
            let mut scene = Scene::new(cell, rng, moves, false);
            for _ in 0..rng.random_range(1..60) {
                scene.follow(rng, seen);
            }
            // Nothing is written while the machine moves on.
            scene.stands(rng.random_range(0.0..1.0));
            scene.vector.begin_ramp();
            scene.ramp_begins = true;
            for _ in 0..60 {
                scene.follow(rng, seen);
            }
            scene.holds_in_windows();
        });
    }
}

/// Given time and room, except for rounding.
#[test]
fn arrives_at_the_whole_correction() {
    over_all_types("arrives", 0.03, |cell, rng, seen| {
        let mut scene = Scene::new(cell, rng, false, false);
        let whole = |asked: &RequestedCorrection| cell.wanted(&scene.path.from, &asked.full());
        let mut wanted = cell.wanted(&scene.path.from, &PerChannel::ZERO);
        for _ in 0..5 {
            wanted = whole(&wanted);
        }
        let full = wanted.full();
        for (i, axis) in scene.limits.axes.iter_mut().enumerate() {
            axis.limit = full[i].abs() + 3.0 * axis.resolution;
        }
        // The linear axes have room for the rotary shares on the way, too.
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
        for (i, axis) in scene
            .limits
            .axes
            .iter()
            .enumerate()
            .take(scene.limits.count)
        {
            let close = 0.6001 * axis.resolution;
            match axis.kind {
                // What is asked for depends on where the axes are, and near a singular pose on their rounding, too: the
                // word is the one for where they are, and within a step of the one for where they would be unrounded.
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
