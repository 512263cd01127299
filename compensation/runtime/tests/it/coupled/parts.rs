//! The parts of a correction against the whole.

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{MAX_AXES, PerAxis};

use super::cell::Cell;

/// For every type of machine and any correcting axes.
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
