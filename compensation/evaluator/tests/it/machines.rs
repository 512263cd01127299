//! The compiled machine equals its source and the exact form on curve objects, for every type of machine.
//!
//! Batches and grids of poses equal single poses.

use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_evaluator::{EvaluatorError, Tolerance};
use volcomp_kinematics::{
    CorrectionOptions, ErrorSource, Form, State, Structure, correct, volumetric_error,
};
use volcomp_model::{CompiledMachine, Machine, Temperatures};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, AxisName, Direction, ErrorName, PerAxis};

use crate::EXAMPLE;

/// Random machine with every kind of error up to ±20 µm and ±30 µrad over 800 mm, curves of order 5, axes with points,
/// and a tool.
pub(crate) fn machine(structure: &Structure, seed: u64) -> Machine {
    use std::fmt::Write;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut number = |size: f64| rng.random_range(-size..=size);
    // Any mixture of motion frames; constant errors may remain between two rotary axes.
    let mut frames = ChaCha8Rng::seed_from_u64(seed);
    let mut text = format!("structure = \"{structure}\"\n");
    for axis in structure.axes() {
        let half = if axis.kind() == AxisKind::Linear { 400.0 } else { 180.0 };
        let point: [f64; 3] = [(); 3].map(|()| number(300.0));
        writeln!(text, "[axes.{axis}]\ntravel = [-{half}, {half}]\npoint = {point:?}").unwrap();
        if axis.is_rotary() && frames.random_bool(0.5) {
            writeln!(text, "motion_frame = \"turning\"").unwrap();
        }
    }
    let tip: [f64; 3] = [(); 3].map(|()| number(150.0));
    writeln!(text, "[tool]\ntip = {tip:?}\n[errors]").unwrap();
    for axis in structure.axes() {
        let half = if axis.kind() == AxisKind::Linear { 400.0 } else { 180.0 };
        for what in ["EX", "EY", "EZ", "EA", "EB", "EC"] {
            let size = if what > "EW" { 20.0 } else { 30.0 } / 3.0;
            let c: [f64; 6] = [(); 6].map(|()| number(size));
            let curve = format!("{{ chebyshev = {c:?}, domain = [-{half}, {half}] }}");
            match what {
                "EX" => writeln!(text, "{what}{axis} = {{ mean = {curve}, reversal = 4.0 }}"),
                _ => writeln!(text, "{what}{axis} = {curve}"),
            }
            .unwrap();
        }
        let own = axis.mcs_index();
        for (k, letter) in ["X", "Y", "Z"].into_iter().enumerate() {
            if k != own {
                if axis.kind() == AxisKind::Rotary {
                    writeln!(text, "E{letter}0{axis} = {}", number(20.0)).unwrap();
                }
                writeln!(text, "E{}0{axis} = {}", ["A", "B", "C"][k], number(30.0)).unwrap();
            }
        }
    }
    writeln!(text, "[assembly]").unwrap();
    for axis in structure.axes() {
        let six: [f64; 6] = [(); 6].map(|()| number(10.0));
        writeln!(text, "{axis} = {six:?}").unwrap();
    }
    Machine::parse(&text, "m.toml").unwrap()
}

pub(crate) fn random_state(machine: &Machine, rng: &mut ChaCha8Rng) -> State {
    let mut state = State::default();
    for (index, joint) in machine.chain().joints().iter().enumerate() {
        state.q[index] = match joint.kind {
            AxisKind::Linear => rng.random_range(-400.0..=400.0),
            AxisKind::Rotary => rng.random_range(-3.1..=3.1),
        };
        state.approach[index] = [Some(Direction::Positive), Some(Direction::Negative), None]
            [rng.random_range(0..3_usize)];
    }
    state
}

/// At 10⁵ poses of each of the 16 types the difference is within the tolerance at the levers, plus the neglected second order: half the square of
/// the total tilt times the reach.
#[test]
fn within_tolerance_and_second_order_of_the_exact_form() {
    const POSES: usize = 100_000;
    let types = all_types();
    let (even, odd): (Vec<_>, Vec<_>) = (0..types.len()).partition(|i| i % 2 == 0);
    let check = |which: Vec<usize>| {
        for index in which {
            let machine = machine(&types[index], index as u64);
            let compiled = machine.compile(Tolerance::default()).unwrap();
            let none = Temperatures::new();
            let mut rng = ChaCha8Rng::seed_from_u64(77);
            let axes = machine.axes().len() as f64;
            // 2400 mm of travels, points and tool; at most 30 + 30 + 10 µrad of tilt per axis.
            let (reach_mm, tilt_rad) = (2400.0, axes * 80e-6 * 3.0_f64.sqrt());
            let bound_mm = axes * (2e-6 + 2e-9 * reach_mm) + 0.5 * tilt_rad * tilt_rad * reach_mm;
            let mut largest = 0.0_f64;
            for _ in 0..POSES {
                let state = random_state(&machine, &mut rng);
                let exact = machine.error_at(&state, Form::Exact, &none);
                let found = compiled.evaluate(&state);
                let miss = (exact.position_mm
                    - volcomp_kinematics::nalgebra::Vector3::from(found.position_mm))
                .norm();
                largest = largest.max(miss);
            }
            println!("{}: {:.4} um of {:.4}", types[index], largest * 1e3, bound_mm * 1e3);
            assert!(largest <= bound_mm, "{}: {largest} over {bound_mm}", types[index]);
            assert!(largest <= 1e-4, "{}: {largest}", types[index]);
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(|| check(even));
        check(odd);
    });
}

/// The compiled evaluation equals the twist form on the compiled curves; this comparison excludes the fit error.
#[test]
fn the_same_as_the_twist_form_on_its_own_curves() {
    for (index, structure) in all_types().iter().enumerate() {
        let machine = machine(structure, 100 + index as u64);
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for _ in 0..200 {
            let state = random_state(&machine, &mut rng);
            let twist = volcomp_kinematics::volumetric_error(
                compiled.chain(),
                &compiled,
                &state,
                Form::Twist,
            );
            let found = compiled.evaluate(&state);
            for k in 0..3 {
                assert!((twist.position_mm[k] - found.position_mm[k]).abs() < 1e-12, "{structure}");
                assert!((twist.rotation_rad[k] - found.rotation_rad[k]).abs() < 1e-15);
            }
        }
    }
}

#[test]
fn the_first_order_correction_is_newtons_first_step() {
    let options = CorrectionOptions::first_order();
    for (index, structure) in all_types().iter().enumerate() {
        let machine = machine(structure, 200 + index as u64);
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let none = Temperatures::new();
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        for _ in 0..500 {
            let state = random_state(&machine, &mut rng);
            let found = compiled.first_order(&state);
            let expected = correct(machine.chain(), &machine.source(&none), &state, &options);
            assert_eq!(
                (found.tool_axis_partial, found.near_singular),
                (expected.tool_axis_partial, expected.near_singular),
                "{structure} {state:?}"
            );
            // Near the singular pose a rotary correction is fifty times its error, so its square matters.
            let largest = expected.delta.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
            let neglected = compiled.neglected().mm(&found.delta);
            for (f, e) in found.delta.iter().zip(&expected.delta) {
                assert!((f - e).abs() < 1e-4 + 0.05 * largest, "{structure}: {f} {e}");
            }
            // The bound holds for the residual after the correction.
            let ideal = machine.chain().ideal_tip_mm(&state);
            let left_with = |delta: &volcomp_vocabulary::PerAxis<f64>| {
                let corrected = volcomp_model::corrected(&state, delta);
                let actual = volcomp_kinematics::actual_pose(
                    machine.chain(),
                    &machine.source(&none),
                    &corrected,
                )
                .transform_point(&machine.chain().tool_tip_mm());
                (actual - machine.chain().workpiece_origin_mm() - ideal).norm()
            };
            let corrected = volcomp_model::corrected(&state, &found.delta);
            let left = left_with(&found.delta);
            assert!(left <= neglected + 1e-4, "{structure}: {left} over {neglected}");
            // The bound also holds for the correction computed at the state that the first correction reaches.
            let second = compiled.first_order(&corrected).delta;
            let left = left_with(&second);
            let neglected = compiled.neglected().there_mm(&found.delta, &second);
            assert!(left <= neglected + 1e-4, "{structure}, anew: {left} over {neglected}");
        }
    }
}

/// Compiled thermal terms equal those of the machine, also outside the range of the curves: expansion stays linear in
/// the coordinate; a drift, linear or angular, is constant.
#[test]
fn thermal_terms_are_those_of_the_source() {
    let text = format!(
        "{EXAMPLE}\n[[thermal.drift]]\nerror = \"EAY\"\nsensors = {{ bed = 1.0 }}\nurad_per_k = 1.5\n"
    );
    let machine = Machine::parse(&text, "m").unwrap();
    let sensors = machine.thermal().sensors();
    assert!(sensors.len() > 1 && !machine.thermal().expansion.is_empty());
    let temperatures: Temperatures = sensors
        .iter()
        .zip([26.5, 31.0, 18.0])
        .map(|(name, degc)| ((*name).to_owned(), degc))
        .collect();
    let compiled = machine.compile_at(Tolerance::default(), &temperatures).unwrap();
    let cold = machine.compile(Tolerance::default()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut moved = 0.0_f64;
    for _ in 0..2000 {
        let mut state = random_state(&machine, &mut rng);
        for q in &mut state.q[1..] {
            *q = rng.random_range(-2000.0..12_000.0);
        }
        let expected = machine.error_at(&state, Form::Twist, &temperatures);
        let found = compiled.evaluate(&state);
        for k in 0..3 {
            assert!((expected.position_mm[k] - found.position_mm[k]).abs() < 5e-5);
            assert!((expected.rotation_rad[k] - found.rotation_rad[k]).abs() < 5e-9);
            moved = moved.max((found.position_mm[k] - cold.evaluate(&state).position_mm[k]).abs());
        }
    }
    assert!(moved > 0.05, "{moved}");
}

#[test]
fn curves_that_need_too_much_are_named() {
    let wave = |period: f64| {
        let text = format!(
            "structure = \"w b X t\"\n[axes.X]\ntravel = [0, 1000]\n[errors]\nEXX = 1.0\nEYX = {{ fourier = [0.0, 5.0], period = {period} }}\n"
        );
        Machine::parse(&text, "m").map(|m| m.compile(Tolerance::default()))
    };
    let nodes: Vec<String> = (0..5000).map(|i| format!("[{}.0, {}.5]", i, i % 7)).collect();
    let table = format!(
        "structure = \"w b X t\"\n[axes.X]\ntravel = [0, 5000]\n[errors]\nEBX = {{ table = [{}] }}\n",
        nodes.join(", ")
    );
    let reason =
        Machine::parse(&table, "m").unwrap().compile(Tolerance::default()).unwrap_err().to_string();
    assert!(
        reason.contains("curve EBX needs more than 1 MiB") && reason.contains("fewer breakpoints"),
        "{reason}"
    );
    // A machine file may reject a Fourier series on a linear axis, but not on C.
    if let Ok(compiled) = wave(2.0) {
        let reason = compiled.unwrap_err().to_string();
        assert!(reason.contains("curve EYX needs more than 1 MiB"), "{reason}");
        assert!(reason.contains("expected a tolerance of"), "{reason}");
    }
}

/// Outside-range flags equal those of the source, also at ends of travel and with a modulo.
#[test]
fn flags_are_those_of_the_source() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let compiled = machine.compile(Tolerance::default()).unwrap();
    let names = |compiled: &CompiledMachine, state: &State| -> Vec<String> {
        let outside = compiled.outside_range(state);
        let mut names: Vec<String> = outside.iter().map(|name| name.to_string()).collect();
        names.sort_unstable();
        names
    };
    let mut seen = std::collections::BTreeSet::new();
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    for step in 0..20_000 {
        let mut state = State {
            q: PerAxis::leading([
                rng.random_range(-8.0..8.0),
                rng.random_range(-500.0..8500.0),
                rng.random_range(-500.0..4500.0),
                rng.random_range(-500.0..3000.0),
            ]),
            ..State::default()
        };
        if step % 10 == 0 {
            state.q[1] = [0.0, 8000.0][step / 10 % 2];
            state.q[2] = [0.0, 4000.0][step / 20 % 2];
        }
        let expected: Vec<String> =
            machine.outside_range(&state).iter().map(ErrorName::to_string).collect();
        let found = names(&compiled, &state);
        assert_eq!(found, expected, "{state:?}");
        seen.extend(found);
    }
    assert!(seen.len() > 3, "{seen:?}");
}

const TOLERANCE_UM: f64 = 1e-3;

proptest! {
    #[test]
    fn within_the_tolerance_everywhere(
        x in -100.0..8100.0, y in -100.0..4100.0, z in -100.0..2600.0, c in -7.0..7.0,
        approach in 0..3_usize,
    ) {
        let machine = Machine::parse(EXAMPLE, "m").unwrap();
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let none = Temperatures::new();
        let source = machine.source(&none);
        let state = State {
            q: PerAxis::leading([c, x, y, z]),
            approach: [[Some(Direction::Positive), Some(Direction::Negative), None][approach]; 9].into(),
        };
        for axis in 0..5 {
            let difference = source.error_motion(axis, &state).linear_mm
                - compiled.error_motion(axis, &state).linear_mm;
            prop_assert!(difference.amax() * 1e3 <= TOLERANCE_UM * 1.01, "{difference}");
            let difference = source.error_motion(axis, &state).angular_rad
                - compiled.error_motion(axis, &state).angular_rad;
            prop_assert!(difference.amax() * 1e6 <= TOLERANCE_UM * 1.01, "{difference}");
            prop_assert_eq!(source.location(axis), compiled.location(axis));
            prop_assert_eq!(source.assembly(axis), compiled.assembly(axis));
        }
    }
}

#[test]
fn the_slope_bound_holds_and_is_tight() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let compiled = machine.compile(Tolerance::from_nm(0.1)).unwrap();
    for (name, curve) in machine.errors() {
        let own = machine.index_of(name.axis).unwrap();
        let [low, high] = machine.axis(name.axis).unwrap().travel;
        let mut coordinates = [0.0; 9];
        let steepest = (0..=4000)
            .map(|step| {
                coordinates[own] = low + (high - low) * f64::from(step) / 4000.0;
                curve.derivative(own, &coordinates, None).abs()
            })
            .fold(0.0, f64::max);
        let per_unit = if name.component.is_angular() { 1e6 } else { 1e3 };
        let bound = compiled.slope_bound(name.axis, name.component) * per_unit;
        assert!(bound >= steepest * 0.999 - 1e-6, "{name}: {bound} under {steepest}");
        // EZY is a grid, and its bound also covers the slope along the second axis.
        assert!(
            bound <= steepest * 1.05 + 1e-3 || name.to_string() == "EZY",
            "{name}: {bound} far over {steepest}"
        );
    }
}

#[test]
fn a_tolerance_that_cannot_be_kept_is_refused() {
    let text = EXAMPLE
        .replace("poly = [0.0, 0.0073, -2.1e-7]", "fourier = [0.0, 0.0, 50.0], period = 0.01");
    let message = Machine::parse(&text, "m")
        .unwrap()
        .compile(Tolerance::from_nm(1e-3))
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("curve EXX needs more than 1 MiB for a tolerance of 0.001 nm"),
        "{message}"
    );
}

/// The calls of a real-time cycle (errors of a compiled machine, volumetric error, correction) do not allocate.
#[test]
fn a_cycle_allocates_nothing() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let compiled = machine.compile(Tolerance::default()).unwrap();
    let options = CorrectionOptions::first_order();
    let mut sum = 0.0;
    for step in 0..100 {
        let q = f64::from(step);
        let state = State {
            q: PerAxis::leading([0.01 * q, 80.0 * q, 40.0 * q, 25.0 * q]),
            ..State::default()
        };
        assert_no_alloc::assert_no_alloc(|| {
            let error = volumetric_error(compiled.chain(), &compiled, &state, Form::Twist);
            let correction = correct(compiled.chain(), &compiled, &state, &options);
            sum += error.position_mm.x + correction.delta[1];
        });
    }
    assert!(sum.is_finite() && sum != 0.0);
}

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
