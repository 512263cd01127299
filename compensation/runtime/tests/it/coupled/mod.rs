//! Tests of the rule for coupled axes: however a correction is limited, ramped or rounded, the tool error is at most
//! the error without correction or the error at the start of the ramp, plus rounding. The exact chain checks this for
//! every type of machine, with oblique axes, random poses and limits. `COUPLED_POSES` is the number of poses of each
//! type.

mod cell;
mod ramps;
mod scene;
mod singular;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use volcomp_test_support::structures::all_types;

use self::{
    cell::{COMPILED_MM, Cell},
    scene::Seen,
};

/// Default number of poses per type of machine.
const POSES: usize = 40;

fn poses() -> usize {
    std::env::var("COUPLED_POSES").ok().and_then(|text| text.parse().ok()).unwrap_or(POSES)
}

/// Runs a scene for every pose of every type of machine on two threads. At most the share `behind` of the cycles may be exempt from the
/// bound because linear axes lag.
fn over_all_types(
    name: &str,
    behind: f64,
    scene: impl Fn(&Cell, &mut ChaCha8Rng, &mut Seen) + Sync,
) {
    let types = all_types();
    let scene = &scene;
    let types = &types;
    let seen: Vec<Seen> = std::thread::scope(|scope| {
        let halves: Vec<_> = (0..2)
            .map(|half| {
                scope.spawn(move || {
                    let mut seen = Seen::default();
                    for (index, structure) in types.iter().enumerate() {
                        if index % 2 != half {
                            continue;
                        }
                        let mut rng = ChaCha8Rng::seed_from_u64(index as u64);
                        let mut cell = Cell::new(structure, &mut rng);
                        for pose in 0..poses() {
                            if pose % 20 == 19 {
                                cell = Cell::new(structure, &mut rng);
                            }
                            scene(&cell, &mut rng, &mut seen);
                            seen.scenes += 1;
                        }
                    }
                    seen
                })
            })
            .collect();
        halves.into_iter().map(|half| half.join().expect("no panic")).collect()
    });
    for seen in &seen {
        println!(
            "{name}: {} scenes, {} cycles, {:.1} % slewing, {:.1} % behind, {:.1} % limited, {} arrived, worst {:.3} um: {}",
            seen.scenes,
            seen.cycles,
            100.0 * seen.slewing as f64 / seen.cycles as f64,
            100.0 * seen.behind as f64 / seen.cycles as f64,
            100.0 * seen.limited as f64 / seen.cycles as f64,
            seen.arrived,
            1e3 * seen.worst.unwrap_or(f64::NAN),
            seen.reported
        );
    }
    for seen in &seen {
        let worst = seen.worst.expect("something was judged");
        assert!(worst <= COMPILED_MM, "{name}: {worst} {}", seen.reported);
        let excused = seen.behind as f64 / seen.cycles as f64;
        assert!(excused <= behind, "{name}: {excused} behind");
    }
}
