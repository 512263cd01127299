//! The compiled evaluator against the exact form on curve objects, over every type of machine.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use volcomp_kinematics::{CorrectionOptions, Form, State, Structure, correct};
use volcomp_model::{CompiledMachine, Machine, Temperatures, Tolerance};
use volcomp_vocabulary::{AxisKind, AxisName, Direction, ErrorName, PerAxis};

use crate::EXAMPLE;

/// The 4 three-axis and 12 five-axis types.
fn all_types() -> Vec<Structure> {
    let mut types = Vec::new();
    for translational in 0..=3 {
        types.push(Structure::from_type(translational, 0, &[]).unwrap());
        for rotary in 1..=3 {
            let pair = [
                [AxisName::C, AxisName::A],
                [AxisName::C, AxisName::B],
                [AxisName::A, AxisName::B],
            ][usize::from(rotary + translational) % 3];
            types.push(Structure::from_type(translational, rotary, &pair).unwrap());
        }
    }
    types
}

/// ±20 um and ±30 urad over 800 mm, every kind of error, curves of order 5, points, a tool.
fn machine(structure: &Structure, seed: u64) -> Machine {
    use std::fmt::Write;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut number = |size: f64| rng.random_range(-size..=size);
    let mut text = format!("structure = \"{structure}\"\n");
    for axis in structure.axes() {
        let half = if axis.kind() == AxisKind::Linear {
            400.0
        } else {
            180.0
        };
        let point: [f64; 3] = [(); 3].map(|()| number(300.0));
        writeln!(
            text,
            "[axes.{axis}]\ntravel = [-{half}, {half}]\npoint = {point:?}"
        )
        .unwrap();
    }
    let tip: [f64; 3] = [(); 3].map(|()| number(150.0));
    writeln!(text, "[tool]\ntip = {tip:?}\n[errors]").unwrap();
    for axis in structure.axes() {
        let half = if axis.kind() == AxisKind::Linear {
            400.0
        } else {
            180.0
        };
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

fn random_state(machine: &Machine, rng: &mut ChaCha8Rng) -> State {
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

/// 10⁶ poses of each of the 16 types: within the tolerance over the levers plus what first order
/// neglects, half the square of all tilts together over the reach.
#[test]
fn within_tolerance_and_second_order_of_the_exact_form() {
    const POSES: usize = 1_000_000;
    let types = all_types();
    let (even, odd): (Vec<_>, Vec<_>) = (0..types.len()).partition(|i| i % 2 == 0);
    let check = |which: Vec<usize>| {
        for index in which {
            let machine = machine(&types[index], index as u64);
            let compiled = machine.compile(Tolerance::default()).unwrap();
            let none = Temperatures::new();
            let mut rng = ChaCha8Rng::seed_from_u64(77);
            let axes = machine.axes().len() as f64;
            // 2400 mm of travels, points and tool; tilts of three sources of 30, 30 and 10 urad.
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
            println!(
                "{}: {:.4} um of {:.4}",
                types[index],
                largest * 1e3,
                bound_mm * 1e3
            );
            assert!(
                largest <= bound_mm,
                "{}: {largest} over {bound_mm}",
                types[index]
            );
            assert!(largest <= 1e-4, "{}: {largest}", types[index]);
        }
    };
    std::thread::scope(|scope| {
        scope.spawn(|| check(even));
        check(odd);
    });
}

/// Without curvature of the curves' fit in the way: the twist form on the compiled curves is the same sum.
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
                assert!(
                    (twist.position_mm[k] - found.position_mm[k]).abs() < 1e-12,
                    "{structure}"
                );
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
            assert_eq!(found.singular, expected.singular, "{structure} {state:?}");
            // Near the singular pose a rotary axis goes fifty times its error: squares of that differ.
            let largest = expected.delta.iter().fold(0.0_f64, |m, d| m.max(d.abs()));
            let neglected = compiled.neglected_mm(&found.delta);
            for (f, e) in found.delta.iter().zip(&expected.delta) {
                assert!(
                    (f - e).abs() < 1e-4 + 0.05 * largest,
                    "{structure}: {f} {e}"
                );
            }
            // The bound holds for what is left with the correction applied.
            let corrected = volcomp_model::corrected(&state, &found.delta);
            let ideal = machine.chain().ideal_tip_mm(&state);
            let actual = volcomp_kinematics::actual_pose(
                machine.chain(),
                &machine.source(&none),
                &corrected,
            )
            .transform_point(&machine.chain().tool_tip_mm());
            let left = (actual - machine.chain().workpiece_origin_mm() - ideal).norm();
            assert!(
                left <= neglected + 1e-4,
                "{structure}: {left} over {neglected}"
            );
        }
    }
}

#[test]
fn batches_are_the_same_as_single_poses() {
    for text in [
        &machine(&"w X' b Y Z t".parse().unwrap(), 1),
        &Machine::parse(EXAMPLE, "m").unwrap(),
    ] {
        let compiled = text.compile(Tolerance::default()).unwrap();
        let count = text.axes().len();
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let states: Vec<State> = (0..10_000).map(|_| random_state(text, &mut rng)).collect();
        let poses: Vec<f64> = states.iter().flat_map(|s| s.q[..count].to_vec()).collect();
        let approach = PerAxis([Some(Direction::Positive); 9]);
        let mut one = vec![[0.0; 6]; states.len()];
        let mut all = one.clone();
        compiled.evaluate_batch(&poses, approach, &mut one);
        compiled.evaluate_batch_parallel(&poses, approach, &mut all);
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

/// Every node of a grid with held rotary axes, odd counts, against single poses.
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
        let grid: Vec<(usize, Vec<f64>)> = linear
            .iter()
            .zip(counts)
            .map(|(&axis, count)| {
                (
                    axis,
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
            state.q[grid[0].0] = grid[0].1[node / 21];
            state.q[grid[1].0] = grid[1].1[node / 7 % 3];
            state.q[grid[2].0] = grid[2].1[node % 7];
            let single = compiled.evaluate(&state);
            for k in 0..3 {
                assert!(
                    (single.position_mm[k] - found[k]).abs() <= 1e-12 * largest,
                    "{structure}"
                );
                assert!((single.rotation_rad[k] - found[k + 3]).abs() <= 1e-12 * largest);
            }
        }
        assert!(compiled.linear_grid(&[], &held).is_none());
        assert!(
            compiled
                .linear_grid(&[(linear[0], vec![])], &held)
                .is_none()
        );
        assert!(compiled.linear_grid(&[(8, vec![1.0])], &held).is_none());
    }
}

/// Expansion goes on outside the range of the curves, drift is a constant, of angles too.
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
    let compiled = machine
        .compile_at(Tolerance::default(), &temperatures)
        .unwrap();
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
    let nodes: Vec<String> = (0..5000)
        .map(|i| format!("[{}.0, {}.5]", i, i % 7))
        .collect();
    let table = format!(
        "structure = \"w b X t\"\n[axes.X]\ntravel = [0, 5000]\n[errors]\nEBX = {{ table = [{}] }}\n",
        nodes.join(", ")
    );
    let reason = Machine::parse(&table, "m")
        .unwrap()
        .compile(Tolerance::default())
        .unwrap_err()
        .to_string();
    assert!(
        reason.contains("curve EBX needs more than 1 MiB") && reason.contains("fewer breakpoints"),
        "{reason}"
    );
    // A Fourier series on a linear axis may be refused by the machine file; on C it is not.
    if let Ok(compiled) = wave(2.0) {
        let reason = compiled.unwrap_err().to_string();
        assert!(
            reason.contains("curve EYX needs more than 1 MiB"),
            "{reason}"
        );
        assert!(reason.contains("expected a tolerance of"), "{reason}");
    }
}

/// Out of range where the source is, ends and a modulo included.
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
        let mut state = State::from_coordinates(&[
            rng.random_range(-8.0..8.0),
            rng.random_range(-500.0..8500.0),
            rng.random_range(-500.0..4500.0),
            rng.random_range(-500.0..3000.0),
        ]);
        if step % 10 == 0 {
            // The ends of travel themselves.
            state.q[1] = [0.0, 8000.0][step / 10 % 2];
            state.q[2] = [0.0, 4000.0][step / 20 % 2];
        }
        let expected: Vec<String> = machine
            .outside_range(&state)
            .iter()
            .map(ErrorName::to_string)
            .collect();
        let found = names(&compiled, &state);
        assert_eq!(found, expected, "{state:?}");
        seen.extend(found);
    }
    assert!(seen.len() > 3, "{seen:?}");
}

#[test]
fn a_blob_is_the_same_machine() {
    let mut machines = vec![Machine::parse(EXAMPLE, "m").unwrap()];
    machines.extend(all_types().iter().map(|s| machine(s, 400)));
    for machine in machines {
        let compiled = machine.compile(Tolerance::default()).unwrap();
        let blob = compiled.to_blob();
        let read = CompiledMachine::from_blob(&blob).unwrap();
        assert_eq!(read.tolerance(), compiled.tolerance());
        let mut rng = ChaCha8Rng::seed_from_u64(12);
        for _ in 0..500 {
            let state = random_state(&machine, &mut rng);
            let (one, other) = (compiled.evaluate(&state), read.evaluate(&state));
            for k in 0..3 {
                assert!((one.position_mm[k] - other.position_mm[k]).abs() < 1e-15);
                assert!((one.rotation_rad[k] - other.rotation_rad[k]).abs() < 1e-18);
            }
            assert_eq!(compiled.outside_range(&state), read.outside_range(&state));
        }
    }
}

#[test]
fn broken_blobs_are_refused() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let blob = machine.compile(Tolerance::default()).unwrap().to_blob();
    let reason = |blob: &[u8]| CompiledMachine::from_blob(blob).unwrap_err().to_string();
    assert!(reason(&blob[..20]).contains("cut off in its head"));
    assert!(reason(b"something else that is long enough for a head of bytes").contains("VOLCOMPM"));
    let mut version = blob.clone();
    version[8] = 9;
    assert!(reason(&version).contains("found version 9, expected 2"));
    let mut changed = blob.clone();
    changed[100] ^= 1;
    assert!(reason(&changed).contains("checksum"));
    assert!(reason(&blob[..blob.len() - 8]).contains("checksum"));
}

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config::with_cases(2000))]
    /// Bytes changed with their checksum mended make a machine or a message, and evaluate without panic.
    #[test]
    fn changed_blobs_do_not_panic(place in 44..40_000_usize, byte in 0..=255_u8, cut in 0..3_usize) {
        use sha2::{Digest, Sha256};
        static BLOB: std::sync::LazyLock<Vec<u8>> = std::sync::LazyLock::new(|| {
            let machine = Machine::parse(EXAMPLE, "m").unwrap();
            machine.compile(Tolerance::from_nm(100.0)).unwrap().to_blob()
        });
        let mut blob = BLOB.clone();
        // Small places hold the counts and names, the rest is mostly numbers.
        let place = if place % 2 == 0 { 44 + place % 400 } else { place };
        if let Some(there) = blob.get_mut(place) {
            *there = byte;
        }
        blob.truncate(blob.len() - cut);
        let sum = Sha256::digest(&blob[44..]);
        blob[12..44].copy_from_slice(&sum);
        if let Ok(machine) = CompiledMachine::from_blob(&blob) {
            for q in [-1e9, -1.0, 0.0, 400.0, 1e300, f64::NAN] {
                let state = State::from_coordinates(&[q; 9]);
                let _ = (machine.evaluate(&state), machine.first_order(&state));
            }
        }
    }
}
