//! The first-order correction of a real-time cycle, and a bound of what it neglects.

use alloc::vec::Vec;

use volcomp_kinematics::{
    Joint, SINGULAR_BELOW, State,
    nalgebra::{Matrix3, Vector2, Vector3},
};
use volcomp_vocabulary::{AxisKind, MAX_AXES};

use crate::{
    machine::{CompiledMachine, Evaluation},
    table::Registers,
    turn::Turn,
    walk::Turns,
};

/// A linear axis corrects when it is at least so far from the plane or line of those before it.
const INDEPENDENT_ABOVE: f64 = 1e-3;

/// How the rotary axes turned, and the levers from their points to the tip.
struct Passed([Option<(Turn, Vector3<f64>)>; MAX_AXES]);

impl Turns for Passed {
    #[inline(always)]
    fn turned(&mut self, index: usize, turn: Turn, lever_mm: Vector3<f64>) {
        self.0[index] = Some((turn, lever_mm));
    }
}

/// What a correction can do, in workpiece axes.
struct Directions {
    axes: [Vector3<f64>; MAX_AXES],
    /// How the tip goes with each rotary axis, mm for each rad.
    arms_mm: [Vector3<f64>; MAX_AXES],
    tool_axis: Vector3<f64>,
}

/// A first-order correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FirstOrder {
    /// The error that is corrected.
    pub error: Evaluation,
    /// Δq in chain order, mm and rad, to be added to the command.
    pub delta: [f64; MAX_AXES],
    /// A direction of the tool axis is not corrected: near a singular pose, or with fewer than two
    /// rotary axes.
    pub singular: bool,
}

impl CompiledMachine {
    /// The correction of one step: rotary axes on the tool axis with the least norm, then the first
    /// linear axis of each direction on position (MODEL.md section 3).
    pub fn first_order(&self, state: &State) -> FirstOrder {
        #[cfg(feature = "std")]
        return crate::batch::one_correction(self, state);
        #[cfg(not(feature = "std"))]
        self.first_order_with::<true>(state, crate::table::Baseline)
    }

    #[inline(always)]
    pub(crate) fn first_order_with<const PATCHED: bool>(
        &self,
        state: &State,
        registers: impl Registers,
    ) -> FirstOrder {
        let mut delta = [0.0; MAX_AXES];
        if self.three_slides {
            let error = self.evaluate_with(state, registers);
            let position = Vector3::from(error.position_mm);
            self.correct_position(
                &position,
                |index| self.axes[index].joint.direction,
                &mut delta,
            );
            return FirstOrder {
                error,
                delta,
                singular: true,
            };
        }
        let mut passed = Passed([None; MAX_AXES]);
        let error = self.walk::<PATCHED>(state, registers, &mut passed);
        let directions = self.directions(&passed, registers);
        let singular = self.correct_axis(&error, &directions, &mut delta);
        let mut position = Vector3::from(error.position_mm);
        for (arm_mm, delta) in directions.arms_mm.iter().zip(&delta) {
            position += arm_mm * *delta;
        }
        self.correct_position(&position, |index| directions.axes[index], &mut delta);
        FirstOrder {
            error,
            delta,
            singular,
        }
    }

    /// Directions and levers in workpiece axes, from the workpiece to the tool.
    #[inline(always)]
    fn directions(&self, passed: &Passed, registers: impl Registers) -> Directions {
        let mut axes = [Vector3::zeros(); MAX_AXES];
        let mut arms_mm = axes;
        // The unit vectors of the body reached so far.
        let mut frame = Matrix3::identity();
        let joints = self.axes.iter().map(|axis| &axis.joint).zip(&passed.0);
        for (index, (joint, turned)) in joints.enumerate() {
            axes[index] = frame * joint.direction;
            if let Some((turn, lever_mm)) = turned {
                arms_mm[index] = frame * joint.direction.cross(lever_mm);
                frame *= turn.matrix(registers);
            }
        }
        Directions {
            axes,
            arms_mm,
            tool_axis: frame * self.chain.tool_axis(),
        }
    }

    /// Rotary axes, least norm on the two components of the tool-axis error normal to it. Whether a
    /// direction is left out.
    #[inline(always)]
    fn correct_axis(
        &self,
        error: &Evaluation,
        directions: &Directions,
        delta: &mut [f64; MAX_AXES],
    ) -> bool {
        let tool_axis = &directions.tool_axis;
        let [first, second] = normals(tool_axis);
        // (v × t) · n = v · (t × n).
        let seen = |v: &Vector3<f64>| Vector2::new(second.dot(v), -first.dot(v));
        let miss = seen(&Vector3::from(error.rotation_rad));
        let mut rows = [Vector2::zeros(); MAX_AXES];
        // A·Aᵀ = [a b; b c].
        let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
        for (index, axis) in self.axes.iter().enumerate() {
            if axis.joint.kind == AxisKind::Rotary {
                let row = seen(&directions.axes[index]);
                (a, b, c) = (a + row.x * row.x, b + row.x * row.y, c + row.y * row.y);
                rows[index] = row;
            }
        }
        let (weighted, singular) = pseudo_inverse(a, b, c, &miss);
        for (delta, row) in delta.iter_mut().zip(&rows) {
            *delta = -row.dot(&weighted);
        }
        singular
    }

    /// Linear axes, exactly on position; of more than three the first independent ones.
    #[inline(always)]
    fn correct_position(
        &self,
        position_mm: &Vector3<f64>,
        column: impl Fn(usize) -> Vector3<f64>,
        delta: &mut [f64; MAX_AXES],
    ) {
        let mut columns = [Vector3::zeros(); 3];
        for (into, &index) in columns.iter_mut().zip(&self.correcting) {
            *into = column(index);
        }
        let count = self.correcting.len();
        if count < 3 {
            fill_with_normals(&mut columns, count);
        }
        // Cramer's rule.
        let [first, second, third] = columns;
        let normals = [
            second.cross(&third),
            third.cross(&first),
            first.cross(&second),
        ];
        let per_volume = 1.0 / first.dot(&normals[0]);
        for (normal, &index) in normals.iter().zip(&self.correcting) {
            delta[index] = -normal.dot(position_mm) * per_volume;
        }
    }

    /// A bound (mm) of the position error that a first-order correction of this size leaves: the
    /// errors change on the way, and tilts have a second order.
    pub fn neglected_mm(&self, delta: &[f64; MAX_AXES]) -> f64 {
        let reach_mm = self.reach_mm();
        let (mut tilts, mut bound) = (0.0, 0.0);
        for (index, (axis, delta)) in self.axes.iter().zip(delta).enumerate() {
            let rotary = axis.joint.kind == AxisKind::Rotary;
            let per_unit = if rotary {
                180.0 / core::f64::consts::PI
            } else {
                1.0
            };
            let slopes = |components: core::ops::Range<usize>| -> f64 {
                components.map(|c| axis.slope_bound(c) * per_unit).sum()
            };
            let (linear, angular) = (slopes(0..3), slopes(3..6));
            let [linear_mm, angular_rad] = axis.size_bounds();
            tilts += angular_rad
                + self.location[index].angular_rad.norm()
                + self.assembly[index].angular_rad.norm();
            let turns = if rotary { libm::fabs(*delta) } else { 0.0 };
            bound += libm::fabs(*delta) * (linear + angular * reach_mm + tilts);
            bound += turns * (linear_mm + turns * reach_mm);
        }
        let turned: f64 = delta
            .iter()
            .zip(&self.axes)
            .filter(|(_, a)| a.joint.kind == AxisKind::Rotary)
            .map(|(d, _)| libm::fabs(*d))
            .sum();
        bound + (tilts + turned) * (tilts + turned) * reach_mm
    }

    /// The longest lever over the travels, mm.
    fn reach_mm(&self) -> f64 {
        let tip = self.chain.tool_tip_mm();
        let mut reach = 0.0_f64;
        let mut travelled = 0.0;
        for axis in &self.axes {
            reach = reach.max((tip - axis.joint.point_mm).norm());
            if axis.joint.kind == AxisKind::Linear {
                travelled += libm::fabs(axis.travel[0]).max(libm::fabs(axis.travel[1]));
            }
        }
        reach + travelled
    }
}

/// (A Aᵀ)⁺ miss for A Aᵀ = [a b; b c], directions below [`SINGULAR_BELOW`] left out, and whether one
/// was.
fn pseudo_inverse(a: f64, b: f64, c: f64, miss: &Vector2<f64>) -> (Vector2<f64>, bool) {
    let half_difference = 0.5 * (a - c);
    let radius = libm::sqrt(half_difference * half_difference + b * b);
    let larger = 0.5 * (a + c) + radius;
    let determinant = a * c - b * b;
    // det/larger instead of the difference: the small eigenvalue keeps its digits.
    let smaller = if larger > 0.0 {
        determinant / larger
    } else {
        0.0
    };
    let least = SINGULAR_BELOW * SINGULAR_BELOW;
    if smaller >= least {
        let solved = Vector2::new(c * miss.x - b * miss.y, a * miss.y - b * miss.x);
        return (solved / determinant, false);
    }
    if larger < least {
        return (Vector2::zeros(), true);
    }
    let candidate = if half_difference >= 0.0 {
        Vector2::new(radius + half_difference, b)
    } else {
        Vector2::new(b, radius - half_difference)
    };
    let vector = candidate.try_normalize(0.0).unwrap_or_else(Vector2::x);
    (vector * (vector.dot(miss) / larger), true)
}

/// The linear axes that correct: the first of each direction, three at the most.
pub(crate) fn correcting(joints: &[Joint]) -> Vec<usize> {
    let mut chosen: Vec<usize> = Vec::new();
    let mut basis: Vec<Vector3<f64>> = Vec::new();
    for (index, joint) in joints.iter().enumerate() {
        if joint.kind == AxisKind::Rotary || basis.len() == 3 {
            continue;
        }
        let mut normal = joint.direction;
        for unit in &basis {
            normal -= unit * unit.dot(&normal);
        }
        let norm = normal.norm();
        if norm > INDEPENDENT_ABOVE {
            basis.push(normal / norm);
            chosen.push(index);
        }
    }
    chosen
}

/// Columns from `count` on become vectors normal to those before: their shares are not applied.
fn fill_with_normals(columns: &mut [Vector3<f64>; 3], count: usize) {
    if count == 0 {
        *columns = [Vector3::x(), Vector3::y(), Vector3::z()];
        return;
    }
    if count == 1 {
        columns[1] = normals(&columns[0])[0];
    }
    columns[2] = columns[0].cross(&columns[1]);
}

/// Two unit vectors that make a right-handed frame with a unit vector as its third (Duff et al.,
/// Building an Orthonormal Basis, Revisited, JCGT 6, 2017).
#[inline(always)]
fn normals(unit: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let sign = 1.0_f64.copysign(unit.z);
    let a = -1.0 / (sign + unit.z);
    let b = unit.x * unit.y * a;
    [
        Vector3::new(1.0 + sign * unit.x * unit.x * a, sign * b, -sign * unit.x),
        Vector3::new(b, sign + unit.y * unit.y * a, -unit.y),
    ]
}
