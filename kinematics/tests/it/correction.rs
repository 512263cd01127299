//! Tests that the correction removes the error, stays small near singular poses, and reports its residual.

use rand::RngExt;
use volcomp_kinematics::{
    Chain, Correction, CorrectionOptions, Correctors, ErrorMotion, ErrorSource, GivenErrors,
    NEAR_SINGULAR_BELOW, SINGULAR_BELOW, State, actual_point_mm, actual_pose, correct,
    least_norm::LinearColumns,
    nalgebra::{DMatrix, Vector3},
};
use volcomp_test_support::structures::all_types;
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

use crate::{every_error, motion, placed, seeded, state, vector};

/// Error motions of ±20 µm and ±30 µrad that vary with the coordinates, and location errors.
struct Wavy {
    base: GivenErrors,
    waves: [f64; MAX_AXES],
}

impl ErrorSource for Wavy {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        let wave = (state.q[axis] / 80.0 + self.waves[axis]).sin();
        let motion = self.base.motion[axis];
        ErrorMotion { linear_mm: motion.linear_mm * wave, angular_rad: motion.angular_rad * wave }
    }
    fn location(&self, axis: usize) -> ErrorMotion {
        self.base.location[axis]
    }
}

/// Singular values of the tool-axis rows, by an independent method: finite differences of the tool axis, decomposed by
/// nalgebra.
fn nominal_singular_values(chain: &Chain, state: &State) -> Vec<f64> {
    let axis = |state: &State| chain.ideal_pose(state).rotation * chain.tool_axis();
    let rotary: Vec<usize> =
        (0..chain.joints().len()).filter(|&i| chain.joints()[i].kind == AxisKind::Rotary).collect();
    let mut rows = DMatrix::zeros(3, rotary.len().max(1));
    for (column, &index) in rotary.iter().enumerate() {
        let (mut plus, mut minus) = (*state, *state);
        plus.q[index] += 1e-5;
        minus.q[index] -= 1e-5;
        rows.set_column(column, &((axis(&plus) - axis(&minus)) / 2e-5));
    }
    let mut values: Vec<f64> = rows.singular_values().iter().copied().collect();
    values.truncate(rotary.len());
    values
}

#[test]
fn shares_of_skew_columns_add_up_to_the_error() {
    let mut rng = seeded(41);
    for _ in 0..100 {
        let columns = [(); 3].map(|()| Vector3::from(vector(&mut rng, 1.0)).normalize());
        let error = Vector3::from(vector(&mut rng, 0.1));
        let skew = LinearColumns::new(columns, 3);
        if skew.is_near_singular(3) {
            continue;
        }
        let shares = skew.shares(&error);
        let sum: Vector3<f64> = columns.iter().zip(shares).map(|(u, s)| u * s).sum();
        assert!((sum - error).norm() < 1e-12, "{columns:?}: {sum}");
    }
}

#[test]
fn rotary_axes_that_are_not_kept_do_not_correct() {
    let chain = Chain::new("w C' A' b X Y Z t".parse().unwrap());
    let mut correctors = Correctors::all(&chain);
    let c = chain.structure().index_of(AxisName::C).unwrap();
    correctors.retain_rotary(|axis| axis == c);
    assert_eq!(correctors.rotary(), [c]);
    assert_eq!(correctors.linear().len(), 3);
}

fn tool_axis_error_rad(chain: &Chain, source: &impl ErrorSource, state: &State) -> f64 {
    let actual = actual_pose(chain, source, state).rotation * chain.tool_axis();
    (actual - chain.ideal_pose(state).rotation * chain.tool_axis()).norm()
}

fn check(chain: &Chain, source: &impl ErrorSource, state: &State) -> Correction {
    let found = correct(chain, source, state, &CorrectionOptions::default());
    let structure = chain.structure();
    assert!(
        found.residual_mm.norm() * 1e3 <= 1e-3,
        "{structure}: {} um",
        found.residual_mm.norm() * 1e3
    );
    assert!(found.iterations <= 4, "{structure}: {} iterations", found.iterations);
    // The residual must be the error of the actual machine at the corrected command.
    let mut command = *state;
    for (q, delta) in command.q.iter_mut().zip(found.delta) {
        *q += delta;
    }
    let tip = actual_pose(chain, source, &command).transform_point(&chain.tool_tip_mm());
    let alone = actual_point_mm(chain, source, &command, &chain.tool_tip_mm());
    assert!((alone - tip).norm() < 1e-10, "{structure}: {alone} {tip}");
    let ideal = chain.ideal_pose(state).transform_point(&chain.tool_tip_mm());
    assert!((tip - ideal - found.residual_mm).norm() < 1e-12);
    let most = 50.0 * tool_axis_error_rad(chain, source, state);
    for (joint, delta) in chain.joints().iter().zip(found.delta) {
        if joint.kind == AxisKind::Rotary {
            assert!(delta.abs() <= most * 1.001, "{structure} {}: {delta} over {most}", joint.name);
        }
    }
    found
}

#[test]
fn nothing_is_left_at_a_thousand_poses_of_each_type() {
    let mut rng = seeded(5);
    for structure in all_types() {
        let chain = placed(&structure, &mut rng);
        let rotary: Vec<usize> = (0..chain.joints().len())
            .filter(|&i| chain.joints()[i].kind == AxisKind::Rotary)
            .collect();
        let (mut regular, mut singular, mut neighbours) = (0, 0, 0);
        for pose in 0..1000 {
            let mut base = every_error(&chain, &mut rng);
            base.assembly = GivenErrors::default().assembly;
            let source = Wavy { base, waves: [(); MAX_AXES].map(|()| rng.random_range(0.0..6.0)) };
            let mut state = state(&chain, &mut rng);
            // A third of the poses are singular, or within 0.1° or 5° of the singular pose.
            if pose % 3 == 0 {
                let most = [0.0, 0.1, 5.0][pose / 3 % 3];
                let near = most * rng.random_range(-1.0_f64..1.0).to_radians();
                for &index in &rotary {
                    state.q[index] =
                        (state.q[index] / 1.6).round() * core::f64::consts::FRAC_PI_2 + near;
                }
            }
            let found = check(&chain, &source, &state);
            let values = nominal_singular_values(&chain, &state);
            let kept = values.iter().filter(|&&s| s >= SINGULAR_BELOW).count();
            if values.iter().all(|s| (s - SINGULAR_BELOW).abs() > 1e-6) {
                assert_eq!(found.tool_axis_partial, kept < 2, "{structure}: {values:?}");
            }
            if rotary.len() >= 2 && values.iter().all(|s| (s - NEAR_SINGULAR_BELOW).abs() > 1e-6) {
                let near = values.get(1).is_none_or(|&s| s < NEAR_SINGULAR_BELOW);
                assert_eq!(found.near_singular, near, "{structure}: {values:?}");
                neighbours += usize::from(near && !found.tool_axis_partial);
            }
            if found.tool_axis_partial {
                singular += 1;
            } else {
                regular += 1;
                assert!(
                    found.residual_axis.norm() * 1e6 <= 1e-3,
                    "{structure}: {} urad",
                    found.residual_axis.norm() * 1e6
                );
            }
        }
        println!("{structure}: {regular} regular, {singular} singular poses");
        if rotary.len() == 2 {
            assert!(
                regular > 500 && singular > 50 && neighbours > 20,
                "{structure}: {regular} {singular} {neighbours}"
            );
        }
    }
}

/// Near the limit of 0.02, where a direction becomes singular, the correction of C changes by less than 3 µrad per
/// 0.001° of A. With a sharp limit, a toggling last digit of A would change C by 506 µrad at once.
#[test]
fn passing_the_edge_of_a_singular_pose_turns_nothing_at_once() {
    let chain = Chain::new("w C' A' b X Y Z t".parse().unwrap());
    let place = |name| chain.structure().index_of(name).unwrap();
    let (c, a) = (place(AxisName::C), place(AxisName::A));
    let mut errors = GivenErrors::default();
    errors.motion[place(AxisName::Z)] = ErrorMotion::from_um_urad([0.0, 0.0, 0.0, 0.0, 10.0, 0.0]);
    let turned = |a_rad: f64| {
        let mut state = State::default();
        state.q[a] = a_rad;
        state.q[c] = 0.3;
        let found = correct(&chain, &errors, &state, &CorrectionOptions::default());
        assert!(found.converged && found.residual_mm.norm() < 1e-8, "{a_rad}");
        found.delta[c]
    };
    let digit = 0.001_f64.to_radians();
    let (mut most, mut largest) = (0.0_f64, 0.0_f64);
    for step in -2000..2000 {
        let at = f64::from(step) * digit;
        let (here, next) = (turned(at), turned(at + digit));
        largest = largest.max(here.abs());
        most = most.max((next - here).abs());
    }
    // Between 0.86° and 1.15°, the correction of C changes by 500 µrad over 287 steps of 0.001°.
    assert!(most < 3e-6, "{most}");
    assert!((450e-6..501e-6).contains(&largest), "{largest}");
    assert_eq!(turned(0.8_f64.to_radians()), 0.0);
}

#[test]
fn one_rotary_axis_corrects_what_it_can() {
    let mut chain = Chain::new("w b X Y Z B t".parse().unwrap());
    chain.set_tool([0.0, 0.0, -100.0], [0.0, 0.0, 1.0]).unwrap();
    let mut errors = GivenErrors::default();
    errors.motion[0] = ErrorMotion::from_um_urad([5.0, 6.0, 7.0, 30.0, 20.0, 10.0]);
    let found = correct(&chain, &errors, &State::default(), &CorrectionOptions::default());
    assert!(found.tool_axis_partial && !found.near_singular && found.converged);
    assert!((found.delta[3] + 20e-6).abs() < 1e-9, "B takes the 20 µrad about Y");
    // A rotation by 30 µrad about X tilts the axis (0, 0, 1) by −30 µrad along Y; this tilt remains as residual.
    let left = Vector3::new(0.0, -30e-6, 0.0);
    assert!((found.residual_axis - left).norm() < 1e-9, "{}", found.residual_axis);
    assert!(found.residual_mm.norm() < 1e-8);
}

#[test]
fn the_first_axis_of_a_direction_corrects_or_those_named() {
    let chain = Chain::new("w X' b Y Z U V t".parse().unwrap());
    let mut errors = GivenErrors::default();
    errors.motion[1] = ErrorMotion::from_um_urad([3.0, 4.0, 5.0, 0.0, 0.0, 0.0]);
    let moved = |options: &CorrectionOptions| {
        let found = correct(&chain, &errors, &State::default(), options);
        assert!(found.residual_mm.norm() < 1e-9);
        found.delta.map(|delta| (delta * 1e3).round())
    };
    let by_default = moved(&CorrectionOptions::default());
    assert_eq!(by_default[..5], [-3.0, -4.0, -5.0, 0.0, 0.0]);
    let options = CorrectionOptions::of(&[AxisName::U, AxisName::V, AxisName::U, AxisName::Z]);
    assert_eq!(moved(&options)[..5], [0.0, 0.0, -5.0, -3.0, -4.0]);
}

/// If errors vary with the coordinates, one step does not converge, which is reported, and ten steps converge. A
/// tolerance that cannot be met is reported as not met.
#[test]
fn a_correction_says_whether_it_converged() {
    let chain = Chain::new("w b X Y Z t".parse().unwrap());
    let mut base = GivenErrors::default();
    base.motion[0] = ErrorMotion::from_um_urad([300.0, 0.0, 0.0, 0.0, 0.0, 900.0]);
    let waves = [1.0; MAX_AXES];
    let source = Wavy { base, waves };
    let state = State::new(&chain, [(AxisName::X, 20.0), (AxisName::Y, 100.0), (AxisName::Z, 0.0)])
        .unwrap();
    let found = |options: &CorrectionOptions| correct(&chain, &source, &state, options);
    let exact = found(&CorrectionOptions::default());
    assert!(exact.converged && exact.residual_mm.norm() <= 1e-8, "{exact:?}");
    let one_step = found(&CorrectionOptions::first_order());
    assert!(!one_step.converged && one_step.residual_mm.norm() > 1e-8, "{one_step:?}");
    let impossible =
        found(&CorrectionOptions { position_tolerance_mm: -1.0, ..CorrectionOptions::default() });
    assert!(!impossible.converged);
}

#[test]
fn a_missing_direction_is_left_as_residual() {
    let chain = Chain::new("w b X Z t".parse().unwrap());
    let mut errors = GivenErrors::default();
    errors.motion[0] = ErrorMotion::from_um_urad([3.0, 4.0, 5.0, 0.0, 0.0, 0.0]);
    let found = correct(&chain, &errors, &State::default(), &CorrectionOptions::default());
    assert!((found.residual_mm - Vector3::new(0.0, 4e-3, 0.0)).norm() < 1e-9);
    assert!((found.delta[0] + 3e-3).abs() < 1e-9 && (found.delta[1] + 5e-3).abs() < 1e-9);
}

/// A NaN coordinate gives NaN corrections, not a zero that looks valid.
#[test]
fn a_pose_that_is_no_number_has_no_correction() {
    let chain = Chain::new("w C' X' b Y Z B t".parse().unwrap());
    let mut errors = GivenErrors::default();
    errors.motion[1] = motion(&mut seeded(7));
    for q in [f64::NAN, f64::INFINITY] {
        let state = State::new(
            &chain,
            [
                (AxisName::C, q),
                (AxisName::X, 1.0),
                (AxisName::Y, 2.0),
                (AxisName::Z, 3.0),
                (AxisName::B, 0.5),
            ],
        )
        .unwrap();
        let found = correct(&chain, &errors, &state, &CorrectionOptions::default());
        assert!(found.delta[..5].iter().all(|delta| !delta.is_finite()), "{found:?}");
        assert!(!found.converged);
    }
}

#[test]
fn nan_ends_and_does_not_panic() {
    let chain = Chain::new("w C' X' b Y Z B t".parse().unwrap());
    let mut errors = GivenErrors::default();
    errors.motion[2] = motion(&mut seeded(6));
    errors.motion[2].linear_mm.x = f64::NAN;
    let found = correct(&chain, &errors, &State::default(), &CorrectionOptions::default());
    assert!(found.residual_mm.x.is_nan() && !found.converged);
}
