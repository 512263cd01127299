//! The exact correction, that of the compiled machine and a plain singular value decomposition agree.
//!
//! The cases are oblique directions, secondary axes U V W, any choice of correcting axes, and any pose.

use nalgebra::{DMatrix, DVector, Vector3};
use rand::{RngExt, SeedableRng, seq::SliceRandom};
use rand_chacha::ChaCha8Rng;
use volcomp_evaluator::{AxisParts, CompiledMachine, MachineParts, Tolerance};
use volcomp_kinematics::{
    Chain, CorrectionOptions, Correctors, ErrorMotion, GivenErrors, State, Structure, actual_pose,
    correct,
};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, MAX_AXES, PerAxis};

use crate::machines::{machine, random_state};

/// Angles between nominally parallel axes, deg, on both sides of 1.15°, above which a direction counts as independent.
const SKEWS_DEG: [f64; 8] = [0.0, 0.01, 0.5, 1.0, 1.3, 3.0, 20.0, 60.0];

fn random_vector(rng: &mut ChaCha8Rng, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.random_range(-size..=size))
}

/// Random oblique axes in any order: one to six linear and up to three rotary ones.
fn random_chain(rng: &mut ChaCha8Rng) -> Chain {
    let mut axes = AxisName::ALL;
    axes.shuffle(rng);
    let (linear, rotary) = (rng.random_range(1..=6), rng.random_range(0..=3));
    let mut left = [linear, rotary];
    let chosen: Vec<AxisName> = axes
        .into_iter()
        .filter(|axis| {
            let room = &mut left[usize::from(axis.is_rotary())];
            *room -= 1;
            *room >= 0
        })
        .collect();
    let side = rng.random_range(0..=chosen.len());
    let structure = Structure::new(&chosen[..side], &chosen[side..]).unwrap();
    let mut chain = Chain::new(structure);
    for axis in chosen {
        let letter = volcomp_kinematics::letter_direction(axis);
        let skew = SKEWS_DEG[rng.random_range(0..SKEWS_DEG.len())].to_radians();
        let aside = letter.cross(&random_vector(rng, 1.0)).normalize();
        let direction = letter * skew.cos() + aside * skew.sin();
        chain.set_direction(axis, direction.into()).unwrap();
        chain.set_point(axis, random_vector(rng, 300.0).into()).unwrap();
    }
    let (tip, axis) = (random_vector(rng, 200.0), random_vector(rng, 1.0));
    chain.set_tool(tip.into(), axis.into()).unwrap();
    chain
}

/// Errors so small that their squares are negligible.
fn tiny_errors(chain: &Chain, rng: &mut ChaCha8Rng) -> (GivenErrors, CompiledMachine) {
    let mut errors = GivenErrors::default();
    let mut parts = MachineParts::new(chain);
    for (index, &axis) in chain.structure().axes().iter().enumerate() {
        let motion = ErrorMotion {
            linear_mm: random_vector(rng, 1e-7),
            angular_rad: random_vector(rng, 1e-10),
        };
        errors.motion[index] = motion;
        let travel = [-1e3, 1e3].map(|end| Displacement::new(axis.kind(), end));
        parts = parts.axis(axis, AxisParts::new(travel, move |_, _| motion)).unwrap();
    }
    (errors, CompiledMachine::new(parts, Tolerance::default()).unwrap())
}

/// The correcting linear axes, chosen independently: the smallest singular value decides whether a column is independent.
fn linear_of(columns: &[(usize, Vector3<f64>)]) -> Vec<(usize, Vector3<f64>)> {
    let mut chosen: Vec<(usize, Vector3<f64>)> = Vec::new();
    for &(index, column) in columns {
        let plane = DMatrix::from_fn(3, chosen.len(), |row, place| chosen[place].1[row]);
        let along = if chosen.is_empty() {
            DVector::zeros(3)
        } else {
            let target = DVector::from_column_slice(column.as_slice());
            &plane * plane.clone().svd(true, true).solve(&target, 1e-12).unwrap()
        };
        let normal = DVector::from_column_slice(column.as_slice()) - along;
        if chosen.len() < 3 && normal.norm() > 0.02 {
            chosen.push((index, column));
        }
    }
    chosen
}

/// The correction by numeric derivatives of the ideal chain and singular value decompositions.
fn by_decomposition(
    chain: &Chain,
    errors: &GivenErrors,
    state: &State,
    names: &[AxisName],
) -> (PerAxis<f64>, bool) {
    let ideal = chain.ideal_pose(state);
    let actual = actual_pose(chain, errors, state);
    let (tip, axis) = (chain.tool_tip_mm(), chain.tool_axis());
    let mut error_mm = actual.transform_point(&tip) - ideal.transform_point(&tip);
    let error_axis = (actual.rotation - ideal.rotation) * axis;
    let derivative = |index: usize| {
        let step = if chain.joints()[index].kind == AxisKind::Linear { 1.0 } else { 1e-4 };
        let at = |by: f64| {
            let mut moved = *state;
            moved.q[index] += by;
            let pose = chain.ideal_pose(&moved);
            (pose.transform_point(&tip), pose.rotation * axis)
        };
        let (up, down) = (at(step), at(-step));
        ((up.0 - down.0) / (2.0 * step), (up.1 - down.1) / (2.0 * step))
    };
    let places: Vec<usize> =
        names.iter().filter_map(|name| chain.structure().index_of(*name)).collect();
    let kind = |index: usize| chain.joints()[index].kind;
    let rotary: Vec<usize> =
        places.iter().copied().filter(|&index| kind(index) == AxisKind::Rotary).collect();
    let mut delta = PerAxis::ZERO;
    let mut rank = 0;
    if !rotary.is_empty() {
        let matrix =
            DMatrix::from_fn(3, rotary.len(), |row, place| derivative(rotary[place]).1[row]);
        let svd = matrix.svd(true, true);
        rank = svd.singular_values.iter().filter(|value| **value >= 0.02).count();
        let (u, v_t) = (svd.u.unwrap(), svd.v_t.unwrap());
        for (place, &index) in rotary.iter().enumerate() {
            // A direction with a singular value below 0.015 is not corrected; one above 0.02 is corrected fully.
            let directions = svd.singular_values.iter().enumerate();
            let shares = directions.filter(|(_, value)| **value > 0.015);
            let share: f64 = shares
                .map(|(i, value)| {
                    let part = ((value - 0.015) / 0.005).min(1.0);
                    part * v_t[(i, place)] * u.column(i).dot(&error_axis) / value
                })
                .sum();
            delta[index] = -share;
            error_mm += derivative(index).0 * delta[index];
        }
    }
    let at_zero: Vec<(usize, Vector3<f64>)> = places
        .iter()
        .filter(|&&index| kind(index) == AxisKind::Linear)
        .map(|&index| (index, chain.joints()[index].direction))
        .collect();
    let chosen: Vec<usize> = linear_of(&at_zero).into_iter().map(|(index, _)| index).collect();
    if !chosen.is_empty() {
        let matrix =
            DMatrix::from_fn(3, chosen.len(), |row, place| derivative(chosen[place]).0[row]);
        let solved = matrix
            .svd(true, true)
            .solve(&DVector::from_column_slice(error_mm.as_slice()), 1e-12)
            .unwrap();
        for (place, &index) in chosen.iter().enumerate() {
            delta[index] = -solved[place];
        }
    }
    (delta, rank < 2)
}

/// Whether a value is so close to the threshold of a decision that rounding may change the decision.
fn is_at_an_edge(chain: &Chain, state: &State, correctors: &Correctors) -> bool {
    let before = |last: usize| {
        let joints = chain.joints().iter().zip(&state.q).take(last);
        joints
            .fold(volcomp_kinematics::Pose::identity(), |pose, (joint, &q)| pose * joint.motion(q))
    };
    let axis = chain.ideal_pose(state).rotation * chain.tool_axis();
    let column = |index: usize| before(index).rotation * chain.joints()[index].direction;
    let rotary = correctors.rotary();
    let rows = DMatrix::from_fn(3, rotary.len().max(1), |row, place| {
        rotary.get(place).map_or(0.0, |&index| column(index).cross(&axis)[row])
    });
    let near = |value: f64, edge: f64| (value - edge).abs() < 1e-6;
    let values = rows.svd(false, false).singular_values;
    // The reference also uses linear axes that a rotation has made parallel.
    let linear = correctors.linear();
    let columns = DMatrix::from_fn(3, linear.len().max(1), |row, place| {
        linear.get(place).map_or(0.0, |&index| column(index)[row])
    });
    let least = columns.svd(false, false).singular_values.min();
    values.iter().any(|value| near(*value, 0.02)) || (!linear.is_empty() && least < 0.012)
}

#[test]
fn exact_first_order_and_decomposition_agree_over_random_machines() {
    let mut rng = ChaCha8Rng::seed_from_u64(20);
    let (mut compared, mut redundant, mut singular) = (0, 0, 0);
    for _ in 0..4000 {
        let chain = random_chain(&mut rng);
        let (errors, mut compiled) = tiny_errors(&chain, &mut rng);
        let mut names = chain.structure().axes().to_vec();
        if rng.random_bool(0.5) {
            names.shuffle(&mut rng);
            names.truncate(rng.random_range(1..=names.len()));
        }
        let state = State {
            q: PerAxis::from_fn(|index| match chain.joints().get(index).map(|joint| joint.kind) {
                Some(AxisKind::Linear) => rng.random_range(-500.0..=500.0),
                Some(AxisKind::Rotary) => rng.random_range(-3.0..=3.0),
                None => 0.0,
            }),
            ..State::default()
        };
        let correctors = Correctors::named(&chain, &names).unwrap();
        if is_at_an_edge(&chain, &state, &correctors) {
            continue;
        }
        let options = CorrectionOptions {
            correct: Some(names.iter().copied().collect()),
            max_iterations: 1,
            position_tolerance_mm: 0.0,
            axis_tolerance_rad: 0.0,
        };
        let exact = correct(&chain, &errors, &state, &options);
        let first = compiled.first_order_of(&state, &correctors);
        compiled.set_correctors(&names).unwrap();
        assert_eq!(compiled.first_order(&state).delta, first.delta);
        let (plain, is_singular) = by_decomposition(&chain, &errors, &state, &names);
        assert_eq!(
            (exact.tool_axis_partial, first.tool_axis_partial),
            (is_singular, is_singular),
            "{chain:?} {state:?}"
        );
        for (index, joint) in chain.joints().iter().enumerate() {
            // Levers of 1 m and corrections of fifty times the error: the comparison is relative to this size.
            let size = if joint.kind == AxisKind::Linear { 1e-4 } else { 1e-8 };
            let (e, f, p) = (exact.delta[index], first.delta[index], plain[index]);
            let build =
                || format!("{} of {} {names:?}: {e} {f} {p}", joint.name, chain.structure());
            assert!((e - p).abs() < 1e-5 * size && (f - p).abs() < 1e-5 * size, "{}", build());
            if !names.contains(&joint.name) {
                assert_eq!((e, f), (0.0, 0.0), "an axis that is not named is held");
            }
        }
        compared += 1;
        let linear = names.iter().filter(|name| !name.is_rotary()).count();
        redundant += usize::from(linear > correctors.linear().len());
        singular += usize::from(is_singular && !correctors.rotary().is_empty());
    }
    assert!(
        compared > 2500 && redundant > 500 && singular > 500,
        "{compared} {redundant} {singular}"
    );
}

/// U is half a degree off X, so it counts as parallel to X and does not correct. A straightness error of X along Y is
/// corrected by Y alone, without large opposite moves of X and U.
#[test]
fn a_second_axis_half_a_degree_off_takes_no_share() {
    let mut chain = Chain::new("w X' b Y Z U t".parse().unwrap());
    let skew = 0.5_f64.to_radians();
    chain.set_direction(AxisName::U, [skew.cos(), skew.sin(), 0.0]).unwrap();
    let straightness = ErrorMotion::from_um_urad([0.0, 10.0, 0.0, 0.0, 0.0, 0.0]);
    let mut errors = GivenErrors::default();
    errors.motion[0] = straightness;
    let mut parts = MachineParts::new(&chain);
    for &axis in chain.structure().axes() {
        let travel = [0.0, 1000.0].map(|end| Displacement::new(axis.kind(), end));
        let motion = if axis == AxisName::X { straightness } else { ErrorMotion::ZERO };
        parts = parts.axis(axis, AxisParts::new(travel, move |_, _| motion)).unwrap();
    }
    let compiled = CompiledMachine::new(parts, Tolerance::default()).unwrap();
    let exact = correct(&chain, &errors, &State::default(), &CorrectionOptions::default());
    let first = compiled.first_order(&State::default());
    for delta in [exact.delta, first.delta] {
        for (index, expected_mm) in [0.0, -0.01, 0.0, 0.0].into_iter().enumerate() {
            assert!((delta[index] - expected_mm).abs() < 1e-9, "{delta:?}");
        }
    }
}

/// X on the bed and Y on a rotary table between them are parallel at C = 90°. Both implementations omit the second of
/// them there, because its correction would be unbounded.
#[test]
fn axes_that_turn_into_one_direction_do_not_take_shares_without_bounds() {
    let chain = Chain::new("w Y' C' X' b Z t".parse().unwrap());
    let (mut rng, options) = (ChaCha8Rng::seed_from_u64(21), CorrectionOptions::default());
    let (errors, compiled) = tiny_errors(&chain, &mut rng);
    for quarter in [0.0, 0.5, 0.99, 0.999, 0.999_999, 1.0] {
        let angle = std::f64::consts::FRAC_PI_2 * quarter;
        let state = State::new(
            &chain,
            [(AxisName::Y, 100.0), (AxisName::C, angle), (AxisName::X, 50.0), (AxisName::Z, -20.0)],
        )
        .unwrap();
        let exact = correct(&chain, &errors, &state, &options);
        let first = compiled.first_order(&state);
        for (e, f) in exact.delta.iter().zip(&first.delta) {
            assert!((e - f).abs() < 1e-9 && e.abs() < 1e-4, "{quarter}: {e} {f}");
        }
    }
}

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
