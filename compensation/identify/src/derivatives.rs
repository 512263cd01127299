//! Actual tool tip and its derivatives with respect to each error of each axis, derived analytically from the exact model.

use volcomp_kinematics::{
    Chain, ErrorMotion, Pose, Side, State,
    nalgebra::{Matrix3, Vector3},
    rotation_about_axis, rotation_from_vector,
};
use volcomp_vocabulary::{AxisKind, MAX_AXES};

/// Errors of all axes at one state, mm and rad, in chain order.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Errors {
    pub(crate) motion: [ErrorMotion; MAX_AXES],
    pub(crate) location: [ErrorMotion; MAX_AXES],
    pub(crate) assembly: [ErrorMotion; MAX_AXES],
}

#[derive(Clone, Debug)]
pub(crate) struct Tip {
    /// Actual tip in workpiece axes, mm, from the machine zero of the workpiece.
    pub(crate) position_mm: Vector3<f64>,
    /// R_actual: tool axes to workpiece axes.
    pub(crate) rotation: Matrix3<f64>,
    /// Derivatives with respect to the six error motions of each axis, mm/mm and mm/rad, axes in chain order.
    pub(crate) by_motion: [[Vector3<f64>; 6]; MAX_AXES],
    /// Derivatives with respect to the six location errors of each axis, in the same units and order.
    pub(crate) by_location: [[Vector3<f64>; 6]; MAX_AXES],
}

/// Left Jacobian J of a rotation vector: exp((r + d)^) = exp((J d)^) exp(r^) to first order in d.
fn left_jacobian(r_rad: &Vector3<f64>) -> Matrix3<f64> {
    let angle_squared = r_rad.norm_squared();
    let hat = r_rad.cross_matrix();
    let (first, second) = if angle_squared < 1e-8 {
        (0.5 - angle_squared / 24.0, 1.0 / 6.0 - angle_squared / 120.0)
    } else {
        let angle = angle_squared.sqrt();
        ((1.0 - angle.cos()) / angle_squared, (angle - angle.sin()) / (angle_squared * angle))
    };
    Matrix3::identity() + hat * first + hat * hat * second
}

/// One factor of the kinematic product: a pose and the errors of `axis` on which it depends.
struct Factor {
    pose: Pose,
    axis: usize,
    kind: FactorKind,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum FactorKind {
    Motion,
    Error,
    Assembly,
}

/// Computes the actual tip of a tool whose functional point is at `tip_mm` (MCS at machine zero), with derivatives.
pub(crate) fn tip(chain: &Chain, errors: &Errors, state: &State, tip_mm: &Vector3<f64>) -> Tip {
    let factors = factors(chain, errors, state);
    let mut tip = Tip {
        position_mm: Vector3::zeros(),
        rotation: Matrix3::identity(),
        by_motion: [[Vector3::zeros(); 6]; MAX_AXES],
        by_location: [[Vector3::zeros(); 6]; MAX_AXES],
    };
    // From tool to workpiece: the point before each factor, and its derivatives by the factor's errors.
    let mut point = *tip_mm;
    for factor in factors.iter().rev() {
        let joint = &chain.joints()[factor.axis];
        let carried = factor.pose.transform_point(&point);
        match factor.kind {
            FactorKind::Assembly => {}
            FactorKind::Error => {
                let error = &errors.motion[factor.axis];
                let by_rotation = left_jacobian(&error.angular_rad);
                let lever = carried - joint.point_mm - error.linear_mm;
                let columns = &mut tip.by_motion[factor.axis];
                for place in 0..3 {
                    columns[place] = Vector3::ith(place, 1.0);
                    columns[place + 3] = (by_rotation * Vector3::ith(place, 1.0)).cross(&lever);
                }
            }
            FactorKind::Motion => {
                let location = &errors.location[factor.axis];
                let by_tilt = left_jacobian(&location.angular_rad);
                let turn = factor.pose.rotation;
                let columns = &mut tip.by_location[factor.axis];
                for place in 0..3 {
                    let tilt = by_tilt * Vector3::ith(place, 1.0);
                    match joint.kind {
                        AxisKind::Linear => {
                            columns[place + 3] = tilt.cross(&factor.pose.translation_mm);
                        }
                        AxisKind::Rotary => {
                            let line = joint.point_mm + location.linear_mm;
                            columns[place] =
                                Vector3::ith(place, 1.0) - turn * Vector3::ith(place, 1.0);
                            // R' = Q R Qᵀ, so dR' v = φ × R'v − R'(φ × v).
                            columns[place + 3] =
                                tilt.cross(&(carried - line)) - turn * tilt.cross(&(point - line));
                        }
                    }
                }
            }
        }
        point = carried;
    }
    tip.position_mm = point;
    // From workpiece to tool: the rotation of all factors to the left of each factor.
    let mut before = Matrix3::identity();
    for factor in &factors {
        let columns = match factor.kind {
            FactorKind::Error => Some(&mut tip.by_motion),
            FactorKind::Motion => Some(&mut tip.by_location),
            FactorKind::Assembly => None,
        };
        for column in columns.into_iter().flat_map(|all| &mut all[factor.axis]) {
            *column = before * *column;
        }
        before *= factor.pose.rotation;
    }
    tip.rotation = before;
    tip
}

/// Factors of the product from the workpiece to the tool, in the order of the model.
fn factors(chain: &Chain, errors: &Errors, state: &State) -> Vec<Factor> {
    use FactorKind::{Assembly, Error, Motion};
    let mut factors = Vec::with_capacity(3 * chain.joints().len());
    for (axis, (joint, &q)) in chain.joints().iter().zip(&state.q).enumerate() {
        let [first, second] =
            if joint.errors_on_tool_side() { [Motion, Error] } else { [Error, Motion] };
        let order = match joint.side {
            Side::Tool => [Assembly, first, second],
            Side::Workpiece => [first, second, Assembly],
        };
        for kind in order {
            let pose = match kind {
                Assembly => Pose {
                    rotation: rotation_from_vector(&errors.assembly[axis].angular_rad),
                    translation_mm: errors.assembly[axis].linear_mm,
                },
                Error => {
                    let error = &errors.motion[axis];
                    let turn = rotation_from_vector(&error.angular_rad);
                    let mut pose = Pose::about_point(turn, joint.point_mm);
                    pose.translation_mm += error.linear_mm;
                    pose
                }
                Motion => {
                    let location = &errors.location[axis];
                    let tilt = rotation_from_vector(&location.angular_rad);
                    let direction = tilt * joint.direction;
                    match joint.kind {
                        AxisKind::Linear => Pose::from_translation(direction * q),
                        AxisKind::Rotary => Pose::about_point(
                            rotation_about_axis(&direction, q),
                            joint.point_mm + location.linear_mm,
                        ),
                    }
                }
            };
            factors.push(Factor { pose, axis, kind });
        }
    }
    factors
}

/// Component of an error motion by index: 0 to 2 linear, mm; 3 to 5 angular, rad.
pub(crate) fn component_of(motion: &mut ErrorMotion, component: usize) -> &mut f64 {
    if component < 3 {
        &mut motion.linear_mm[component]
    } else {
        &mut motion.angular_rad[component - 3]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use volcomp_kinematics::{ErrorSource, GivenErrors, MotionFrame, actual_pose};
    use volcomp_vocabulary::PerAxis;

    const STRUCTURES: [&str; 5] = [
        "w b X Y Z C B t",
        "w C' A' X' b Y Z t",
        "w C' X' b Y Z B t",
        "w X' b Y Z t",
        "w Y' b U X Z C A t",
    ];

    /// Errors a hundred times those of a machine, so that a first-order approximation would fail.
    fn random_errors(numbers: &[f64]) -> Errors {
        let mut errors = Errors::default();
        let mut next = numbers.iter().cycle();
        let mut vector =
            |scale: f64| Vector3::from_fn(|_, _| scale * next.next().copied().unwrap_or_default());
        for axis in 0..MAX_AXES {
            for list in [&mut errors.motion, &mut errors.location, &mut errors.assembly] {
                list[axis].linear_mm = vector(2.0);
                list[axis].angular_rad = vector(0.02);
            }
        }
        errors
    }

    fn given(errors: &Errors) -> GivenErrors {
        GivenErrors {
            motion: PerAxis(errors.motion),
            location: PerAxis(errors.location),
            assembly: PerAxis(errors.assembly),
        }
    }

    fn position(chain: &Chain, errors: &Errors, state: &State, tip: &Vector3<f64>) -> Vector3<f64> {
        actual_pose(chain, &given(errors), state).transform_point(tip)
    }

    proptest! {
        #[test]
        fn derivatives_are_the_central_differences_of_the_exact_model(
            structure in 0..STRUCTURES.len(),
            turning in prop::collection::vec(prop::bool::ANY, MAX_AXES),
            q in prop::collection::vec(-1.0..1.0f64, 9),
            numbers in prop::collection::vec(-1.0..1.0f64, 61),
        ) {
            let mut chain = Chain::new(STRUCTURES[structure].parse().expect("a structure"));
            let axes: Vec<_> = chain.structure().axes().to_vec();
            for (place, axis) in axes.iter().enumerate() {
                let point = [100.0 * numbers[place], 80.0, -60.0 * numbers[place + 1]];
                chain.set_point(*axis, point).expect("finite");
                if axis.is_rotary() && turning[place] {
                    chain.set_motion_frame(*axis, MotionFrame::Turning).expect("a rotary axis");
                }
            }
            let mut state = State::default();
            for (place, axis) in axes.iter().enumerate() {
                state.q[place] = if axis.is_rotary() { 2.0 } else { 500.0 } * q[place];
            }
            let errors = random_errors(&numbers);
            let tool = Vector3::new(30.0, -20.0, -150.0);
            let found = tip(&chain, &errors, &state, &tool);
            let exact = position(&chain, &errors, &state, &tool);
            prop_assert!((found.position_mm - exact).norm() < 1e-9);
            let pose = actual_pose(&chain, &given(&errors), &state);
            prop_assert!((found.rotation - pose.rotation).norm() < 1e-12);
            prop_assert_eq!(given(&errors).location(0), errors.location[0]);
            for axis in 0..axes.len() {
                for place in 0..6 {
                    let step = if place < 3 { 1e-2 } else { 1e-5 };
                    for location in [false, true] {
                        let moved = |by: f64| {
                            let mut moved = errors;
                            let list = if location { &mut moved.location } else { &mut moved.motion };
                            *component_of(&mut list[axis], place) += by;
                            position(&chain, &moved, &state, &tool)
                        };
                        let expected = (moved(step) - moved(-step)) / (2.0 * step);
                        let columns = if location { &found.by_location } else { &found.by_motion };
                        let difference = (columns[axis][place] - expected).norm();
                        prop_assert!(difference < 1e-6 * (1.0 + expected.norm()),
                            "{} axis {axis} component {place} location {location}: {difference}", STRUCTURES[structure]);
                    }
                }
            }
        }
    }
}
