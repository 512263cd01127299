//! The chord bound compared with the error at many points of the move.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::State;
use volcomp_model::{Machine, Tolerance};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::AxisName;

use crate::machines::{machine, random_state};

/// Largest distance between the error and its chord over many points of the move, mm.
fn found_mm(machine: &volcomp_evaluator::CompiledMachine, from: &State, to: &State) -> f64 {
    let at = |share: f64| {
        let mut state = *to;
        for (q, from) in state.q.iter_mut().zip(&from.q) {
            *q = from + share * (*q - from);
        }
        machine.evaluate(&state).position_mm
    };
    let [first, last] = [at(0.0), at(1.0)];
    let mut largest = 0.0_f64;
    for step in 1..100 {
        let share = f64::from(step) / 100.0;
        let found = at(share);
        let away: f64 =
            (0..3).map(|i| (found[i] - first[i] - share * (last[i] - first[i])).powi(2)).sum();
        largest = largest.max(away.sqrt());
    }
    largest
}

#[test]
fn the_bound_holds_on_every_type() {
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    for (index, structure) in all_types().iter().enumerate() {
        let machine = machine(structure, 700 + index as u64);
        let compiled = machine.compile(Tolerance::default()).unwrap();
        for _ in 0..150 {
            let from = random_state(&machine, &mut rng);
            let mut to = random_state(&machine, &mut rng);
            let share = [1.0, 0.3, 0.03, 0.001][rng.random_range(0..4)];
            for (to, from) in to.q.iter_mut().zip(&from.q) {
                *to = from + share * (*to - from);
            }
            let bound = compiled.chord_bound_mm(&from, &to);
            let found = found_mm(&compiled, &from, &to);
            assert!(found <= bound + 1e-9, "{structure:?} {share}: {found} {bound}");
            assert!(bound.is_finite());
        }
    }
}

/// Without curvature the bound is 0. With a curved error the bound is between one and four times the deviation, which
/// grows with the square of the length.
#[test]
fn the_bound_is_as_tight_as_the_curves_are() {
    let text = |curve: &str| {
        format!(
            "name = \"m\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0, 1000]\n[axes.Y]\ntravel = [0, 500]\n[axes.Z]\ntravel = [0, 500]\n[errors]\n{curve}"
        )
    };
    let chain = volcomp_kinematics::Chain::new("w X' b Y Z t".parse().unwrap());
    let ends = |x: f64| {
        [
            State::new(&chain, [(AxisName::X, 0.0), (AxisName::Y, 0.0), (AxisName::Z, 50.0)])
                .unwrap(),
            State::new(&chain, [(AxisName::X, x), (AxisName::Y, x), (AxisName::Z, 50.0)]).unwrap(),
        ]
    };
    let straight = text(
        "EXX = { poly = [1.0, 0.01] }\nEYX = { poly = [0.0, 0.02] }\nEC0Y = 20.0\nECX = 3.0\n",
    );
    let compiled = Machine::parse(&straight, "m").unwrap();
    let compiled = compiled.compile(Tolerance::default()).unwrap();
    let [from, to] = ends(400.0);
    assert!(compiled.chord_bound_mm(&from, &to) < 1e-9);
    let curved = text("EXX = { poly = [0.0, 0.0, 1e-4] }\n");
    let compiled = Machine::parse(&curved, "m").unwrap();
    let compiled = compiled.compile(Tolerance::default()).unwrap();
    for x in [1.0, 10.0, 100.0, 400.0] {
        let [from, to] = ends(x);
        // 1e-4 µm/mm² over x: the parabola deviates from its chord by 1e-4·x²/4 µm in the middle.
        let exact = 1e-7 * x * x / 4.0;
        let found = found_mm(&compiled, &from, &to);
        assert!((found - exact).abs() < 1e-3 * exact + 2e-9, "{found} {exact}");
        let bound = compiled.chord_bound_mm(&from, &to);
        assert!(bound >= exact - 1e-12 && bound <= 4.0 * exact, "{bound} {exact}");
    }
}

/// Within `short_ways` the bound never exceeds the tolerance; over a fraction of these lengths it never exceeds that fraction of the tolerance.
#[test]
fn short_ways_are_within_the_tolerance() {
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    for (index, structure) in all_types().iter().enumerate() {
        let machine = machine(structure, 800 + index as u64);
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let tolerance_mm = [1e-4, 1e-3, 1e-2][index % 3];
        let ways = compiled.short_ways(tolerance_mm);
        assert!(ways.iter().all(|way| *way > 0.0));
        for _ in 0..100 {
            let from = random_state(&machine, &mut rng);
            let mut to = random_state(&machine, &mut rng);
            let count = machine.axes().len();
            let mut shares: Vec<f64> = (0..count).map(|_| rng.random_range(0.0..1.0)).collect();
            let all: f64 = shares.iter().sum();
            let part = [1.0, rng.random_range(0.0..1.0)][usize::from(rng.random::<bool>())];
            for share in &mut shares {
                *share *= part / all;
            }
            for i in 0..count {
                let way = shares[i] * ways[i].min(1e3);
                to.q[i] = from.q[i] + if rng.random() { way } else { -way };
            }
            let bound = compiled.chord_bound_mm(&from, &to);
            assert!(bound <= part * tolerance_mm * (1.0 + 1e-9), "{structure:?}: {bound}");
        }
    }
}
