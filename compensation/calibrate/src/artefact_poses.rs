//! Poses of the artefacts of measured lines on a machine. The machine coordinate system is not accessible, so that the axes are the only references
//! for alignment.

use core::f64::consts::{FRAC_PI_2, PI};

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_kinematics::{
    ErrorMotion, ErrorSource, Pose, State, actual_pose,
    nalgebra::{Matrix3, Vector3},
    vector_from_rotation,
};
use volcomp_metrology::{MotionKind, ReferenceLine};
use volcomp_model::{Machine, ModelError, Temperatures};
use volcomp_vocabulary::{AxisName, Component, Displacement, ErrorName, MAX_AXES, Urad};

use crate::{
    calibration_file::{CalibrationFile, measured},
    squareness::set_square,
};

/// Number of targets of a straightness that was not measured.
const TARGETS: usize = 21;
/// Two unit directions are treated as parallel if the component of one normal to the other is at most this.
const PARALLEL_BELOW: f64 = 0.02;

/// Poses of the artefacts on the workpiece side and on the tool side, aligned so that the machine has no error with all
/// axes at `reference`.
///
/// An artefact on the workpiece side is aligned to the reference lines of the reference axes, at the position of the
/// tool tip at `reference`. The artefact or instrument in the tool is aligned to that artefact in this pose. Readings
/// therefore do not depend on the constants of error motions and the slopes of straightnesses, which are conventions.
#[derive(Clone, Copy, Debug)]
pub struct ArtefactPoses {
    /// Pose of the workpiece axes in the frame of the artefact on the workpiece side, mm.
    pub workpiece: Pose,
    /// Pose of the artefact on the tool side in tool axes, mm.
    pub tool: Pose,
}

impl ArtefactPoses {
    /// Poses on the machine of a calibration file before its lines are evaluated: the measured error motions and the
    /// squarenesses of the file are zero.
    pub(crate) fn before_lines(
        file: &CalibrationFile,
        known: &Machine,
    ) -> Result<Self, ModelError> {
        let mut machine = known.clone();
        for error in measured(file) {
            if machine.error(error).is_some() {
                machine.set_error(error, ErrorCurve::Single(Field::Curve(Curve::Constant(0.0))))?;
            }
        }
        for square in &file.squareness {
            set_square(&mut machine, file.reference_axes, square.error, Urad(0.0))?;
        }
        Ok(Self::of(&machine, &file.reference, file.reference_axes, |_| None))
    }

    /// Poses with the axes at `reference` (mm or deg, in machine order; an axis without a value is at 0) along the
    /// reference lines of two axes. The reference line of a straightness is fitted at the targets (mm) that `targets`
    /// returns; for `None`, at 21 targets over the travel.
    pub fn of(
        machine: &Machine,
        reference: &[f64],
        reference_axes: [AxisName; 2],
        targets: impl Fn(ErrorName) -> Option<Vec<f64>>,
    ) -> Self {
        let zero = state_at(machine, reference);
        let errors = ReferenceLines::of(machine, zero, targets);
        let chain = machine.chain();
        let tip = chain.tool_tip_mm();
        let (actual, ideal) = (actual_pose(chain, &errors, &zero), chain.ideal_pose(&zero));
        let others = [AxisName::X, AxisName::Y, AxisName::Z].into_iter();
        let others = others.filter(|axis| !reference_axes.contains(axis));
        let directions = reference_axes.into_iter().chain(others).filter_map(|name| {
            let mut moved = zero;
            moved.q[machine.index_of(name).ok()?] += 1.0;
            let to = chain.ideal_pose(&moved).transform_point(&tip);
            let actual_to = actual_pose(chain, &errors, &moved).transform_point(&tip);
            Some([to - ideal.transform_point(&tip), actual_to - actual.transform_point(&tip)])
        });
        // On a machine with fewer than two linear axes, axes of the tool replace them.
        let of_tool =
            (0..3).map(|k| [&ideal, &actual].map(|pose| pose.rotation.column(k).into_owned()));
        let turned = Pose::about_point(turn(directions.chain(of_tool)), Vector3::zeros());
        let there = (turned * actual).transform_point(&tip);
        let workpiece = Pose::from_translation(ideal.transform_point(&tip) - there) * turned;
        Self { workpiece, tool: (workpiece * actual).inverse() * ideal }
    }
}

/// Location of the line of a rotary axis (mm, rad) relative to the nominal line, in MCS at machine zero, as an
/// instrument measures it: set up as in [`ArtefactPoses::of`] with all axes at `reference`, relative to the tool tip,
/// along the reference lines of the reference axes. `[[location]]` of a calibration file states this value.
///
/// # Errors
///
/// An axis that the machine does not have.
pub fn location_seen(
    machine: &Machine,
    axis: AxisName,
    reference: &[f64],
    reference_axes: [AxisName; 2],
    targets: impl Fn(ErrorName) -> Option<Vec<f64>>,
) -> Result<ErrorMotion, ModelError> {
    let index = machine.index_of(axis)?;
    let seen = ArtefactPoses::of(machine, reference, reference_axes, &targets).workpiece;
    let zero = state_at(machine, reference);
    let errors = ReferenceLines::of(machine, zero, &targets);
    let chain = machine.chain();
    let joint = &chain.joints()[index];
    let before = chain.joints()[..index].iter().zip(&zero.q);
    let before = before.fold(Pose::identity(), |pose, (joint, q)| pose * joint.motion(*q));
    let to_axis = before.inverse() * seen;
    // Rotation of the axis alone as seen from the workpiece, in the frame in which the axis is
    // stated at machine zero.
    let turned_by = |angle_rad: f64| {
        let mut turned = zero;
        turned.q[index] += angle_rad;
        let pose = |state: &State| actual_pose(chain, &errors, state);
        to_axis * pose(&turned) * pose(&zero).inverse() * to_axis.inverse()
    };
    // The rotation vector of a quarter turn has the direction of the axis. Half a turn moves a point to the opposite
    // side of the axis.
    let direction = vector_from_rotation(&turned_by(FRAC_PI_2).rotation) / FRAC_PI_2;
    let point = joint.point_mm;
    Ok(ErrorMotion {
        linear_mm: 0.5 * (turned_by(PI).transform_point(&point) - point),
        angular_rad: joint.direction.cross(&direction),
    })
}

/// Command at coordinates in mm or deg; an axis without a value is at 0.
fn state_at(machine: &Machine, reference: &[f64]) -> State {
    let mut state = State::default();
    for ((axis, q), at) in machine.axes().iter().zip(&mut state.q).zip(reference) {
        *q = Displacement::from_coordinate(axis.name.kind(), *at).mm_or_rad();
    }
    state
}

fn over([low, high]: [f64; 2]) -> Vec<f64> {
    let share = |target: usize| target as f64 / (TARGETS - 1) as f64;
    (0..TARGETS).map(|target| low + (high - low) * share(target)).collect()
}

/// Rotation from the actual directions of two axes to their nominal directions: exact for the first axis, and in the
/// plane of both for the second. `directions` are pairs of nominal and actual direction, in order of priority.
fn turn(directions: impl Iterator<Item = [Vector3<f64>; 2]>) -> Matrix3<f64> {
    let mut frames = [Matrix3::identity(); 2];
    let mut found = 0;
    for pair in directions {
        let across = |place: usize| {
            let first: Vector3<f64> = frames[place].column(0).into();
            match found {
                0 => pair[place],
                _ => pair[place] - first * first.dot(&pair[place]),
            }
        };
        let across = [across(0), across(1)];
        if across[0].norm() < PARALLEL_BELOW {
            continue;
        }
        for (frame, across) in frames.iter_mut().zip(across) {
            frame.set_column(found, &across.normalize());
        }
        found += 1;
        if found == 2 {
            break;
        }
    }
    let [nominal, actual] = frames.map(|mut frame| {
        let third = frame.column(0).cross(&frame.column(1));
        frame.set_column(2, &third);
        frame
    });
    nominal * actual.transpose()
}

/// The errors of a machine whose axes move along their reference lines: the errors at the reference state `zero`, and
/// from there only the slopes of the straightnesses.
struct ReferenceLines {
    zero: State,
    motions: [ErrorMotion; MAX_AXES],
    locations: [ErrorMotion; MAX_AXES],
    assemblies: [ErrorMotion; MAX_AXES],
    /// Slopes of the straightnesses, mm/mm.
    slopes: [Vector3<f64>; MAX_AXES],
}

impl ReferenceLines {
    fn of(machine: &Machine, zero: State, targets: impl Fn(ErrorName) -> Option<Vec<f64>>) -> Self {
        let none = Temperatures::new();
        let source = machine.source(&none);
        let mut lines = Self {
            zero,
            motions: [ErrorMotion::ZERO; MAX_AXES],
            locations: [ErrorMotion::ZERO; MAX_AXES],
            assemblies: [ErrorMotion::ZERO; MAX_AXES],
            slopes: [Vector3::zeros(); MAX_AXES],
        };
        for (index, axis) in machine.axes().iter().enumerate() {
            lines.motions[index] = source.error_motion(index, &zero);
            lines.locations[index] = source.location(index);
            lines.assemblies[index] = source.assembly(index);
            for component in Component::ALL {
                let error = ErrorName::motion(component, axis.name);
                if MotionKind::of(error) != MotionKind::Straightness {
                    continue;
                }
                let k = component.mcs_index();
                let point = |target: f64| {
                    let mut state = zero;
                    state.q[index] = target;
                    (target, source.error_motion(index, &state).linear_mm[k] * 1e3)
                };
                let targets = targets(error).unwrap_or_else(|| over(axis.travel)).into_iter();
                let points: Vec<(f64, f64)> = targets.map(point).collect();
                // A travel of zero length has no line.
                if let Ok(line) = ReferenceLine::least_squares(&points) {
                    lines.motions[index].linear_mm[k] = line.value_um(zero.q[index]) * 1e-3;
                    lines.slopes[index][k] = line.slope_um_per_mm * 1e-3;
                }
            }
        }
        lines
    }
}

impl ErrorSource for ReferenceLines {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        let mut motion = self.motions[axis];
        motion.linear_mm += self.slopes[axis] * (state.q[axis] - self.zero.q[axis]);
        motion
    }

    fn location(&self, axis: usize) -> ErrorMotion {
        self.locations[axis]
    }

    fn assembly(&self, axis: usize) -> ErrorMotion {
        self.assemblies[axis]
    }
}
