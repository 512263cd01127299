//! The first-order correction of a real-time cycle, and a bound of what it neglects.

use volcomp_kinematics::{
    JointKind, MAX_AXES, State,
    nalgebra::{Matrix3, Vector2, Vector3},
};

use crate::{
    machine::{CompiledMachine, Evaluation},
    table::Baseline,
    walk::Directions,
};

/// Below this singular value of the rotary rows a direction of the tool axis is left out (MODEL.md
/// section 3).
const SINGULAR_BELOW: f64 = volcomp_kinematics::SINGULAR_BELOW;
/// A linear axis corrects when it is at least so far from the plane or line of those before it.
const INDEPENDENT_ABOVE: f64 = 1e-3;

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
        if self.only_slides {
            let error = self.slides(&state.q, &state.approach, Baseline);
            let mut delta = [0.0; MAX_AXES];
            let columns = |index: usize| self.axes[index].joint.direction;
            self.correct_position(&Vector3::from(error.position_mm), columns, &mut delta);
            return FirstOrder {
                error,
                delta,
                singular: true,
            };
        }
        let mut directions = Directions::new(self.chain.tool_axis());
        let error = self.walk(state, Baseline, &mut directions);
        let mut delta = [0.0; MAX_AXES];
        let singular = self.correct_axis(&error, &directions, &mut delta);
        let mut position = Vector3::from(error.position_mm);
        for (index, axis) in self.axes.iter().enumerate() {
            if axis.joint.kind == JointKind::Rotary {
                position += directions.arms_mm[index] * delta[index];
            }
        }
        self.correct_position(&position, |index| directions.axes[index], &mut delta);
        FirstOrder {
            error,
            delta,
            singular,
        }
    }

    /// Rotary axes, least norm on the two components of the tool-axis error normal to it. Whether a
    /// direction is left out.
    fn correct_axis(
        &self,
        error: &Evaluation,
        directions: &Directions,
        delta: &mut [f64; MAX_AXES],
    ) -> bool {
        let tool_axis = &directions.tool_axis;
        let mut helper = Vector3::zeros();
        helper[tool_axis.iamin()] = 1.0;
        let first = tool_axis.cross(&helper).normalize();
        let second = tool_axis.cross(&first);
        let seen = |v: &Vector3<f64>| Vector2::new(first.dot(v), second.dot(v));
        let miss = seen(&Vector3::from(error.rotation_rad).cross(tool_axis));
        let mut rows = [Vector2::zeros(); MAX_AXES];
        // A·Aᵀ = [a b; b c].
        let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
        for (index, axis) in self.axes.iter().enumerate() {
            if axis.joint.kind == JointKind::Rotary {
                let row = seen(&directions.axes[index].cross(tool_axis));
                (a, b, c) = (a + row.x * row.x, b + row.x * row.y, c + row.y * row.y);
                rows[index] = row;
            }
        }
        let weighted = pseudo_inverse(a, b, c, &miss);
        for (delta, row) in delta.iter_mut().zip(&rows) {
            *delta = -row.dot(&weighted.0);
        }
        weighted.1
    }

    /// Linear axes, exactly on position; of more than three the first independent ones.
    fn correct_position(
        &self,
        position_mm: &Vector3<f64>,
        column: impl Fn(usize) -> Vector3<f64>,
        delta: &mut [f64; MAX_AXES],
    ) {
        let mut matrix = Matrix3::identity();
        let mut chosen = [0; 3];
        let mut count = 0;
        let mut basis = [Vector3::zeros(); 3];
        for (index, axis) in self.axes.iter().enumerate() {
            if axis.joint.kind == JointKind::Rotary || count == 3 {
                continue;
            }
            let mut normal = axis.joint.direction;
            for unit in &basis[..count] {
                normal -= unit * unit.dot(&normal);
            }
            let norm = normal.norm();
            if norm > INDEPENDENT_ABOVE {
                basis[count] = normal / norm;
                chosen[count] = index;
                matrix.set_column(count, &column(index));
                count += 1;
            }
        }
        if count < 3 {
            fill_with_normals(&mut matrix, count);
        }
        let shares = matrix.try_inverse().unwrap_or_else(Matrix3::zeros) * position_mm;
        for (place, &index) in chosen[..count].iter().enumerate() {
            delta[index] = -shares[place];
        }
    }

    /// A bound (mm) of the position error that a first-order correction of this size leaves: the
    /// errors change on the way, and tilts have a second order.
    pub fn neglected_mm(&self, delta: &[f64; MAX_AXES]) -> f64 {
        let reach_mm = self.reach_mm();
        let (mut tilts, mut bound) = (0.0, 0.0);
        for (axis, delta) in self.axes.iter().zip(delta) {
            let size = axis.tables.iter().fold([0.0_f64; 2], |most, table| {
                let m = table.magnitudes();
                let norm = |v: [f64; 3]| Vector3::from(v).norm();
                [
                    most[0].max(norm([m[0], m[1], m[2]])),
                    most[1].max(norm([m[3], m[4], m[5]])),
                ]
            });
            let per_unit = if axis.joint.kind == JointKind::Linear {
                1.0
            } else {
                180.0 / core::f64::consts::PI
            };
            let (mut linear, mut angular) = (0.0, 0.0);
            for component in 0..6 {
                let slope = self.slope_bound(axis.joint.name, component) * per_unit;
                *(if component < 3 {
                    &mut linear
                } else {
                    &mut angular
                }) += slope;
            }
            tilts += size[1] + axis.location.angular_rad.norm() + axis.assembly.angular_rad.norm();
            let turns = if axis.joint.kind == JointKind::Rotary {
                libm::fabs(*delta)
            } else {
                0.0
            };
            bound += libm::fabs(*delta) * (linear + angular * reach_mm + tilts);
            bound += turns * (size[0] + turns * reach_mm);
        }
        let turned: f64 = delta
            .iter()
            .zip(&self.axes)
            .filter(|(_, a)| a.joint.kind == JointKind::Rotary)
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
            if axis.joint.kind == JointKind::Linear {
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

/// Columns from `count` on become unit vectors normal to those before: their shares are not applied.
fn fill_with_normals(matrix: &mut Matrix3<f64>, count: usize) {
    let column = |matrix: &Matrix3<f64>, i: usize| Vector3::from(matrix.column(i));
    if count == 0 {
        *matrix = Matrix3::identity();
        return;
    }
    if count == 1 {
        let first = column(matrix, 0);
        let mut helper = Vector3::zeros();
        helper[first.iamin()] = 1.0;
        matrix.set_column(1, &first.cross(&helper).normalize());
    }
    let third = column(matrix, 0).cross(&column(matrix, 1)).normalize();
    matrix.set_column(2, &third);
}
