//! The correction of a command: what must be added so that the actual tool pose is the ideal one.

use arrayvec::ArrayVec;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

use crate::{
    chain::Chain,
    error_form::actual_pose,
    math::sqrt,
    pose::Pose,
    source::{ErrorSource, State},
};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

/// A rotary direction whose nominal singular value is below this is left out (about 1° from the
/// singular pose); no rotary correction is then more than 1/0.02 = 50 times the tool-axis error.
pub const SINGULAR_BELOW: f64 = 0.02;

/// A linear axis counts as a new direction when this much of it is normal to those already chosen.
const INDEPENDENT_ABOVE: f64 = 0.02;

/// How a correction is computed.
#[derive(Clone, Debug, PartialEq)]
pub struct CorrectionOptions {
    /// The linear axes that may correct, most wanted first; `None`: the first axis of each direction
    /// in chain order.
    pub correct: Option<ArrayVec<AxisName, MAX_AXES>>,
    /// Newton steps at the most; 1 is the first-order correction of a real-time cycle.
    pub max_iterations: usize,
    /// Stop when the correctable position residual is below this, mm.
    pub position_tolerance_mm: f64,
    /// Stop when the correctable tool-axis residual is below this, rad.
    pub axis_tolerance_rad: f64,
}

impl Default for CorrectionOptions {
    /// All directions, up to 10 steps, 1e-5 µm and 1e-4 µrad.
    fn default() -> Self {
        Self {
            correct: None,
            max_iterations: 10,
            position_tolerance_mm: 1e-8,
            axis_tolerance_rad: 1e-10,
        }
    }
}

impl CorrectionOptions {
    /// One Newton step.
    #[must_use]
    pub fn first_order() -> Self {
        Self {
            max_iterations: 1,
            ..Self::default()
        }
    }
}

/// A correction and what it leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Correction {
    /// Δq in chain order: mm for linear axes, rad for rotary ones, to be added to the command.
    pub delta: [f64; MAX_AXES],
    /// actual − ideal tip, mm in workpiece axes, with the correction applied.
    pub residual_mm: Vector3<f64>,
    /// actual − ideal unit tool axis, in workpiece axes, with the correction applied.
    pub residual_axis: Vector3<f64>,
    /// Newton steps taken.
    pub iterations: usize,
    /// A direction of the tool axis is not corrected: near a singular pose, or with fewer than two
    /// rotary axes.
    pub singular: bool,
}

/// The correction at a command `state`.
///
/// Each step first moves the rotary axes alone (minimum norm, on the tool-axis error), then the
/// linear axes on position; position is never traded for orientation. Errors are evaluated at the
/// corrected coordinates on the reversal branches of `state.approach`.
pub fn correct<S: ErrorSource>(
    chain: &Chain,
    source: &S,
    state: &State,
    options: &CorrectionOptions,
) -> Correction {
    let goal = Goal::new(chain, state);
    let rank = RotaryRows::at(chain, state, &goal).rank();
    let linear = linear_correctors(chain, options);
    let mut corrected = *state;
    let mut iterations = 0;
    loop {
        let miss = goal.miss(chain, &actual_pose(chain, source, &corrected));
        let rows = RotaryRows::at(chain, &corrected, &goal);
        let step = rows.least_norm_step(&goal.normal_components(&miss.axis), rank);
        let position = LinearColumns::at(chain, &corrected, &linear).solve(&miss.position_mm);
        let done = step.seen_rad <= options.axis_tolerance_rad
            && position.seen_mm <= options.position_tolerance_mm;
        if done || iterations >= options.max_iterations {
            return Correction {
                delta: core::array::from_fn(|i| corrected.q[i] - state.q[i]),
                residual_mm: miss.position_mm,
                residual_axis: miss.axis,
                iterations,
                singular: rank < 2,
            };
        }
        iterations += 1;
        for (index, radians) in step.rotary {
            corrected.q[index] -= radians;
        }
        let miss = goal.miss(chain, &actual_pose(chain, source, &corrected));
        let position = LinearColumns::at(chain, &corrected, &linear).solve(&miss.position_mm);
        for (index, millimetres) in position.linear {
            corrected.q[index] -= millimetres;
        }
    }
}

/// The ideal tool pose at the command.
struct Goal {
    tip_mm: Vector3<f64>,
    axis: Vector3<f64>,
    /// Two unit vectors normal to the tool axis and to one another.
    normals: [Vector3<f64>; 2],
}

struct Miss {
    position_mm: Vector3<f64>,
    axis: Vector3<f64>,
}

impl Goal {
    fn new(chain: &Chain, state: &State) -> Self {
        let pose = chain.ideal_pose(state);
        let axis = pose.rotation * chain.tool_axis();
        let mut helper = Vector3::zeros();
        helper[axis.iamin()] = 1.0;
        let first = axis.cross(&helper).normalize();
        Self {
            tip_mm: pose.transform_point(&chain.tool_tip_mm()),
            axis,
            normals: [first, axis.cross(&first)],
        }
    }

    fn miss(&self, chain: &Chain, actual: &Pose) -> Miss {
        Miss {
            position_mm: actual.transform_point(&chain.tool_tip_mm()) - self.tip_mm,
            axis: actual.rotation * chain.tool_axis() - self.axis,
        }
    }

    fn normal_components(&self, v: &Vector3<f64>) -> Vector2<f64> {
        Vector2::new(self.normals[0].dot(v), self.normals[1].dot(v))
    }
}

/// How the tool axis turns with each rotary axis: a 2×n matrix on the ideal chain, rad per rad.
struct RotaryRows {
    columns: ArrayVec<(usize, Vector2<f64>), MAX_AXES>,
    /// Eigenvalues σ² of A·Aᵀ, the larger first, and their unit vectors.
    squares: [f64; 2],
    vectors: [Vector2<f64>; 2],
}

struct RotaryStep {
    rotary: ArrayVec<(usize, f64), MAX_AXES>,
    /// How much of the tool-axis error the kept directions see, rad.
    seen_rad: f64,
}

impl RotaryRows {
    fn at(chain: &Chain, state: &State, goal: &Goal) -> Self {
        let mut columns = ArrayVec::new();
        let tool_axis = chain.ideal_pose(state).rotation * chain.tool_axis();
        let mut before = Pose::identity();
        for (index, (joint, &q)) in chain.joints().iter().zip(&state.q).enumerate() {
            if joint.kind == AxisKind::Rotary {
                let turned = (before.rotation * joint.direction).cross(&tool_axis);
                columns.push((index, goal.normal_components(&turned)));
            }
            before = before * joint.motion(q);
        }
        let gram = columns
            .iter()
            .fold(Matrix2::zeros(), |sum: Matrix2<f64>, (_, c)| {
                sum + c * c.transpose()
            });
        let (squares, vectors) = symmetric_eigen(&gram);
        Self {
            columns,
            squares,
            vectors,
        }
    }

    fn rank(&self) -> usize {
        let kept = |square: &&f64| **square >= SINGULAR_BELOW * SINGULAR_BELOW;
        self.squares.iter().filter(kept).count()
    }

    /// A⁺·error on the first `rank` singular directions.
    fn least_norm_step(&self, error: &Vector2<f64>, rank: usize) -> RotaryStep {
        let mut weighted = Vector2::zeros();
        let mut seen = Vector2::zeros();
        for (square, vector) in self.squares.iter().zip(&self.vectors).take(rank) {
            let part = vector * vector.dot(error);
            weighted += part / *square;
            seen += part;
        }
        RotaryStep {
            rotary: self
                .columns
                .iter()
                .map(|(index, column)| (*index, column.dot(&weighted)))
                .collect(),
            seen_rad: seen.norm(),
        }
    }
}

/// Eigenvalues, larger first, and unit eigenvectors of a symmetric 2×2 matrix.
fn symmetric_eigen(m: &Matrix2<f64>) -> ([f64; 2], [Vector2<f64>; 2]) {
    let (a, b, c) = (m[(0, 0)], m[(0, 1)], m[(1, 1)]);
    let half_difference = 0.5 * (a - c);
    let radius = sqrt(half_difference * half_difference + b * b);
    let larger = 0.5 * (a + c) + radius;
    // det/larger instead of the difference: the small one keeps its digits.
    let smaller = if larger > 0.0 {
        ((a * c - b * b) / larger).max(0.0)
    } else {
        0.0
    };
    let candidate = if half_difference >= 0.0 {
        Vector2::new(radius + half_difference, b)
    } else {
        Vector2::new(b, radius - half_difference)
    };
    let first = candidate.try_normalize(0.0).unwrap_or_else(Vector2::x);
    ([larger, smaller], [first, Vector2::new(-first.y, first.x)])
}

/// The places in the chain of the linear axes that correct: at most three independent directions.
fn linear_correctors(chain: &Chain, options: &CorrectionOptions) -> ArrayVec<usize, 3> {
    let linear = |name: &AxisName| {
        let index = chain.structure().index_of(*name)?;
        (name.kind() == AxisKind::Linear).then_some(index)
    };
    let wanted: &[AxisName] = match &options.correct {
        Some(names) => names,
        None => chain.structure().axes(),
    };
    let mut chosen = ArrayVec::<usize, 3>::new();
    let mut basis = ArrayVec::<Vector3<f64>, 3>::new();
    for index in wanted.iter().filter_map(linear) {
        // Directions are compared at machine zero: rotary axes between two linear ones turn whole
        // groups, and a group that is parallel there is one slide on another.
        let mut normal = chain.joints()[index].direction;
        for unit in &basis {
            normal -= unit * unit.dot(&normal);
        }
        if basis.len() < 3 && normal.norm() > INDEPENDENT_ABOVE {
            basis.push(normal.normalize());
            chosen.push(index);
        }
    }
    chosen
}

/// How the tool tip moves with each correcting linear axis, mm per mm in workpiece axes.
struct LinearColumns {
    columns: ArrayVec<(usize, Vector3<f64>), 3>,
}

struct LinearStep {
    linear: ArrayVec<(usize, f64), 3>,
    /// How much of the position error the columns span, mm.
    seen_mm: f64,
}

impl LinearColumns {
    fn at(chain: &Chain, state: &State, correctors: &[usize]) -> Self {
        let mut columns = ArrayVec::new();
        let mut before = Pose::identity();
        for (index, (joint, &q)) in chain.joints().iter().zip(&state.q).enumerate() {
            if correctors.contains(&index) {
                columns.push((index, before.rotation * joint.direction));
            }
            before = before * joint.motion(q);
        }
        Self { columns }
    }

    /// Exact with three columns, least squares with fewer.
    fn solve(&self, error: &Vector3<f64>) -> LinearStep {
        let mut matrix = Matrix3::zeros();
        for (place, (_, column)) in self.columns.iter().enumerate() {
            matrix.set_column(place, column);
        }
        // Missing columns are filled with directions normal to those there are, so that the system
        // stays regular and their share is simply not applied.
        let count = self.columns.len();
        for place in count..3 {
            matrix.set_column(place, &normal_to(&matrix, place));
        }
        let Some(inverse) = matrix.try_inverse() else {
            return LinearStep {
                linear: ArrayVec::new(),
                seen_mm: 0.0,
            };
        };
        let shares = inverse * error;
        let mut seen = Vector3::zeros();
        let mut linear = ArrayVec::new();
        for (place, (index, column)) in self.columns.iter().enumerate() {
            seen += column * shares[place];
            linear.push((*index, shares[place]));
        }
        LinearStep {
            linear,
            seen_mm: seen.norm(),
        }
    }
}

/// A unit vector normal to the first `count` columns (0, 1 or 2 of them).
fn normal_to(matrix: &Matrix3<f64>, count: usize) -> Vector3<f64> {
    let column = |i| Vector3::from(matrix.column(i));
    match count {
        0 => Vector3::x(),
        1 => {
            let mut helper = Vector3::zeros();
            helper[column(0).iamin()] = 1.0;
            column(0).cross(&helper).normalize()
        }
        _ => column(0).cross(&column(1)).normalize(),
    }
}
