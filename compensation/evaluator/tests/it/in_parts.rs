//! The parts of a correction compared with the whole, and with central differences of the ideal chain.

use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use volcomp_evaluator::CompiledMachine;
use volcomp_kinematics::{Chain, Correctors, State, nalgebra::Vector3};
use volcomp_model::Tolerance;
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{MAX_AXES, PerAxis};

use crate::machines::{machine, random_state};

/// Machines of every type whose axes deviate by some degrees from their letters, with some or all axes correcting.
fn over_all_types(
    mut check: impl FnMut(&CompiledMachine, &Correctors, &State, &mut ChaCha8Rng, bool),
) {
    let mut rng = ChaCha8Rng::seed_from_u64(31);
    for (index, structure) in all_types().iter().enumerate() {
        for oblique in [false, true] {
            let text = machine(structure, 300 + index as u64).to_toml();
            let lines = text.lines().filter(|line| !line.starts_with("checksum"));
            let mut text: String = lines.flat_map(|line| [line, "\n"]).collect();
            if oblique {
                for axis in structure.axes() {
                    let letter = volcomp_kinematics::letter_direction(*axis);
                    let aside = Vector3::from_fn(|_, _| rng.random_range(-0.1..=0.1));
                    let direction: [f64; 3] = (letter + aside).normalize().into();
                    let table = format!("[axes.{axis}]\n");
                    text = text.replace(&table, &format!("{table}direction = {direction:?}\n"));
                }
            }
            let machine = volcomp_model::Machine::parse(&text, "m.toml").unwrap();
            let compiled = machine.compile(Tolerance::default()).unwrap();
            for pose in 0..200 {
                let mut names = structure.axes().to_vec();
                if pose % 2 == 1 {
                    names.shuffle(&mut rng);
                    names.truncate(rng.random_range(1..=names.len()));
                }
                let correctors = compiled.correctors_among(&names);
                let state = random_state(&machine, &mut rng);
                check(&compiled, &correctors, &state, &mut rng, pose % 2 == 0);
            }
        }
    }
}

#[test]
fn together_they_are_the_whole_correction() {
    over_all_types(|compiled, correctors, state, _, _| {
        let whole = compiled.first_order_of(state, correctors);
        let parts = compiled.parts_of(state, correctors);
        assert_eq!(
            (parts.error, parts.tool_axis_partial, parts.near_singular),
            (whole.error, whole.tool_axis_partial, whole.near_singular)
        );
        for (index, (sum, delta)) in parts.delta().iter().zip(&whole.delta).enumerate() {
            assert!((sum - delta).abs() < 1e-13, "{index}: {sum} {delta}");
        }
        for index in 0..MAX_AXES {
            if !correctors.linear().contains(&index) {
                assert_eq!(parts.position[index], 0.0);
                assert!(parts.follow.iter().all(|row| row[index] == 0.0));
            }
            if !correctors.rotary().contains(&index) {
                assert_eq!(parts.rotary[index], 0.0);
            }
            if !compiled.chain().structure().axes().get(index).is_some_and(|axis| axis.is_rotary())
            {
                assert_eq!(parts.follow[index], PerAxis::ZERO);
            }
        }
    });
}

/// Ideal tip after the move `delta`, in workpiece axes.
fn tip(chain: &Chain, state: &State, delta: &PerAxis<f64>) -> Vector3<f64> {
    let mut there = *state;
    for (q, delta) in there.q.iter_mut().zip(delta) {
        *q += delta;
    }
    chain.ideal_tip_mm(&there)
}

/// With all linear axes correcting, the tip stays while a rotary axis moves and the linear axes follow, and the position share moves the
/// tip opposite to the position error.
#[test]
fn the_tip_stays_while_linear_axes_follow() {
    over_all_types(|compiled, correctors, state, rng, all| {
        if !all {
            return;
        }
        let parts = compiled.parts_of(state, correctors);
        let chain = compiled.chain();
        let along = |delta: &PerAxis<f64>| {
            let back = delta.map(|delta| -delta);
            0.5 * (tip(chain, state, delta) - tip(chain, state, &back))
        };
        let axes = chain.structure().axes().iter().enumerate();
        for r in axes.filter_map(|(r, axis)| axis.is_rotary().then_some(r)) {
            let turn = rng.random_range(1e-5..=1e-4);
            let mut delta = parts.follow[r].map(|follow| follow * turn);
            delta[r] = turn;
            let moved = along(&delta).norm() / turn;
            assert!(moved < 1e-4, "{moved} mm/rad of {}", chain.structure());
        }
        let moved = along(&parts.position);
        let left = moved + Vector3::from(parts.error.position_mm);
        assert!(left.norm() < 1e-10, "{left:?}");
    });
}

#[test]
fn parts_allocate_nothing() {
    over_all_types(|compiled, correctors, state, _, _| {
        let sum = assert_no_alloc::assert_no_alloc(|| {
            let parts = compiled.parts_of(state, correctors);
            parts.delta().iter().sum::<f64>()
        });
        assert!(sum.is_finite());
    });
}

/// The lever of an axis is the tip's motion per rad, by central differences, at any coordinate of the axis.
#[test]
fn levers_are_central_differences_of_the_tip() {
    over_all_types(|compiled, _, state, _, _| {
        let chain = compiled.chain();
        for (index, axis) in chain.structure().axes().iter().enumerate() {
            let mut delta = PerAxis::ZERO;
            delta[index] = 1e-5;
            let back = delta.map(|delta| -delta);
            let went = (tip(chain, state, &delta) - tip(chain, state, &back)).norm() / 2e-5;
            let expected = if axis.is_rotary() { went } else { 0.0 };
            let lever = chain.lever_mm(index, state);
            assert!((lever - expected).abs() < 1e-4, "{axis}: {lever} {went}");
        }
    });
}

/// Without rotary axes, three linear axes correct a position error as Gaussian elimination does, and fewer axes as the general correction does.
#[test]
fn slides_take_the_whole_error() {
    let mut solved = 0;
    over_all_types(|compiled, _, state, rng, _| {
        let joints = compiled.chain().joints();
        let turns = joints.iter().any(|joint| joint.kind == volcomp_vocabulary::AxisKind::Rotary);
        let mut compiled = compiled.clone();
        let mut names = compiled.chain().structure().axes().to_vec();
        names.shuffle(rng);
        names.truncate(rng.random_range(1..=names.len()));
        let some: bool = rng.random();
        if some {
            compiled.set_correctors(&names).unwrap();
        }
        let Some(slides) = compiled.slides() else {
            assert!(turns);
            return;
        };
        assert!(!turns);
        let error = compiled.evaluate(state);
        let delta = slides.delta(&error);
        let whole = compiled.first_order(state).delta;
        for (delta, whole) in delta.iter().zip(&whole) {
            assert!((delta - whole).abs() < 1e-15, "{delta} {whole}");
        }
        if !some {
            let columns = [0, 1, 2].map(|axis| joints[axis].direction);
            let columns = volcomp_kinematics::nalgebra::Matrix3::from_columns(&columns);
            let wanted = columns.lu().solve(&-Vector3::from(error.position_mm));
            let found = Vector3::new(delta[0], delta[1], delta[2]);
            assert!((found - wanted.unwrap()).norm() < 1e-12 * (1.0 + found.norm()));
            solved += 1;
        }
    });
    assert!(solved > 100, "{solved}");
}
