//! Batches and grids of poses equal single poses.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use volcomp_evaluator::EvaluatorError;
use volcomp_kinematics::State;
use volcomp_model::{Machine, Tolerance};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, AxisName, Direction, PerAxis};

use crate::{
    EXAMPLE,
    machines::{machine, random_state},
};

#[test]
fn batches_are_the_same_as_single_poses() {
    for text in
        [&machine(&"w X' b Y Z t".parse().unwrap(), 1), &Machine::parse(EXAMPLE, "m").unwrap()]
    {
        let compiled = text.compile(Tolerance::default()).unwrap();
        let count = text.axes().len();
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let states: Vec<State> = (0..10_000).map(|_| random_state(text, &mut rng)).collect();
        let poses: Vec<f64> = states.iter().flat_map(|s| s.q[..count].to_vec()).collect();
        let approach = PerAxis([Some(Direction::Positive); 9]);
        let mut one = vec![[0.0; 6]; states.len()];
        let mut all = one.clone();
        let order = compiled.chain().structure().axes();
        compiled.evaluate_batch(order, &poses, approach, &mut one).unwrap();
        compiled.evaluate_batch_parallel(order, &poses, approach, &mut all).unwrap();
        assert_eq!(one, all);
        let largest = one.iter().flatten().fold(0.0_f64, |m, e| m.max(e.abs()));
        for (state, found) in states.iter().zip(&one) {
            let single = compiled.evaluate(&State { approach, ..*state });
            for k in 0..3 {
                assert!((single.position_mm[k] - found[k]).abs() <= 1e-12 * largest);
                assert!((single.rotation_rad[k] - found[k + 3]).abs() <= 1e-12 * largest);
            }
        }
    }
}

#[test]
fn a_batch_in_another_order_is_refused() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let compiled = machine.compile(Tolerance::default()).unwrap();
    let mut order = compiled.chain().structure().axes().to_vec();
    order.swap(0, 1);
    let mut errors = [[0.0; 6]; 1];
    let approach = PerAxis([None; 9]);
    for found in [
        compiled.evaluate_batch(&order, &[0.0; 5], approach, &mut errors),
        compiled.evaluate_batch_parallel(&order, &[0.0; 5], approach, &mut errors),
        compiled.evaluate_batch(&order[1..], &[0.0; 5], approach, &mut errors),
    ] {
        assert!(matches!(found, Err(EvaluatorError::AxisOrder { .. })), "{found:?}");
    }
}

/// With held rotary axes and odd counts, every node of a grid has the error of the single pose.
#[test]
fn grids_are_the_same_as_single_poses() {
    for (index, structure) in all_types().iter().enumerate() {
        let machine = machine(structure, 300 + index as u64);
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let held = random_state(&machine, &mut rng);
        let linear: Vec<usize> = (0..machine.axes().len())
            .filter(|&i| machine.chain().joints()[i].kind == AxisKind::Linear)
            .collect();
        let counts = [5, 3, 7];
        let grid: Vec<(AxisName, Vec<f64>)> = linear
            .iter()
            .zip(counts)
            .map(|(&axis, count)| {
                (
                    machine.axes()[axis].name,
                    (0..count).map(|i| 97.0 * f64::from(i) - 300.0).collect(),
                )
            })
            .collect();
        let compiled_grid = compiled.linear_grid(&grid, &held).unwrap();
        assert_eq!(compiled_grid.len(), 105);
        let mut errors = vec![0.0; 6 * 105];
        let mut parallel = errors.clone();
        compiled_grid.fill_rows(0, &mut errors);
        compiled_grid.fill_parallel(&mut parallel);
        assert_eq!(errors, parallel);
        let largest = errors.iter().fold(0.0_f64, |m, e| m.max(e.abs()));
        for (node, found) in errors.chunks(6).enumerate() {
            let mut state = held;
            state.q[linear[0]] = grid[0].1[node / 21];
            state.q[linear[1]] = grid[1].1[node / 7 % 3];
            state.q[linear[2]] = grid[2].1[node % 7];
            let single = compiled.evaluate(&state);
            for k in 0..3 {
                assert!((single.position_mm[k] - found[k]).abs() <= 1e-12 * largest, "{structure}");
                assert!((single.rotation_rad[k] - found[k + 3]).abs() <= 1e-12 * largest);
            }
        }
        assert!(compiled.linear_grid(&[], &held).is_none());
        assert!(compiled.linear_grid(&[(grid[0].0, vec![])], &held).is_none());
        assert!(compiled.linear_grid(&[(AxisName::W, vec![1.0])], &held).is_none());
        let turned = [grid[1].clone(), grid[0].clone()];
        assert!(compiled.linear_grid(&turned, &held).is_none());
    }
}
