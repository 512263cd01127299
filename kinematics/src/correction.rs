//! Correction of a command: the axis displacements that make the actual tool pose equal to the ideal pose.

use arrayvec::ArrayVec;
use nalgebra::{Vector2, Vector3};
use volcomp_vocabulary::{AxisName, MAX_AXES, PerAxis};

use crate::chain::{Chain, ErrorSource, State};
use crate::correctors::Correctors;
use crate::error_form::actual_pose;
use crate::least_norm::{LinearColumns, RotaryGram, normals};
use crate::pose::Pose;

/// Options of a correction: the axes that may move and the end of the iteration.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CorrectionOptions {
    /// The linear and rotary axes that may move; all other axes are held. Errors that these axes cannot correct remain
    /// as residual. The order decides which linear axes are used (see [`Correctors`]). Names of axes that the chain
    /// does not contain are ignored. `None`: all axes, in the order of the chain.
    pub correct: Option<ArrayVec<AxisName, MAX_AXES>>,
    /// Maximum number of Newton steps; 1 gives the first-order correction of a real-time cycle.
    pub max_iterations: usize,
    /// The iteration ends when the correctable position residual is at most this (mm) and the tool-axis residual is at
    /// most `axis_tolerance_rad`.
    pub position_tolerance_mm: f64,
    /// Tolerance of the correctable tool-axis residual, rad; see `position_tolerance_mm`.
    pub axis_tolerance_rad: f64,
}

impl Default for CorrectionOptions {
    /// All axes, at most 10 steps, tolerances of 1e-5 µm and 1e-4 µrad.
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
    /// Options that move only these axes, in this order of preference, with default values otherwise. Repeated names
    /// are ignored.
    #[must_use]
    pub fn of(axes: &[AxisName]) -> Self {
        let mut named = ArrayVec::new();
        for &axis in axes {
            if !named.contains(&axis) {
                named.push(axis); // nine different letters exist, so nine places are enough
            }
        }
        Self { correct: Some(named), ..Self::default() }
    }

    /// The axes of a chain that a correction with these options moves.
    pub fn correctors(&self, chain: &Chain) -> Correctors {
        match &self.correct {
            Some(names) => Correctors::choose(chain, names),
            None => Correctors::all(chain),
        }
    }

    /// Options for a single Newton step with all axes: the first-order correction.
    #[must_use]
    pub fn first_order() -> Self {
        Self { max_iterations: 1, ..Self::default() }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Correction {
    /// Displacements Δq to be added to the command, in the order of the chain: mm for linear axes, rad for rotary axes.
    pub delta: PerAxis<f64>,
    /// Actual minus ideal tip position with the correction applied, mm in workpiece axes.
    pub residual_mm: Vector3<f64>,
    /// Actual minus ideal unit vector of the tool axis with the correction applied, in workpiece axes.
    pub residual_axis: Vector3<f64>,
    /// Number of Newton steps taken.
    pub iterations: usize,
    /// Whether the correctable residual is within the tolerances after at most the maximum number of steps; false if a
    /// position or an error is not finite. Without convergence, `delta` is the larger of the first and the last
    /// iterate, because the iteration can swing back to almost zero if errors grow faster than the coordinate.
    pub converged: bool,
    /// Whether the tilt of the tool remains partly or wholly uncorrected in one or both directions, because the pose is
    /// within about 1° of a singular pose or because fewer than two rotary axes may move.
    pub tool_axis_partial: bool,
    /// True if at least two rotary axes may move and the pose is within about 6° of a singular pose. The rotary axes
    /// then move by more than 10 times the tool-axis error, or one direction remains uncorrected. See
    /// [`NEAR_SINGULAR_BELOW`](crate::NEAR_SINGULAR_BELOW).
    pub near_singular: bool,
}

/// Computes the correction at the command `state`.
///
/// Each Newton step first moves the rotary axes to remove the tool-axis error (least norm), and then the linear axes to
/// remove the position error. The position error is thus never increased to reduce the tool-axis error. Errors are
/// evaluated at the corrected coordinates, on the branches of `state.approach`.
pub fn correct<S: ErrorSource>(
    chain: &Chain,
    source: &S,
    state: &State,
    options: &CorrectionOptions,
) -> Correction {
    let goal = Goal::new(chain, state);
    let correctors = options.correctors(chain);
    // The uncorrected directions are determined once, on the ideal chain at the command.
    let nominal = Columns::at(chain, state, &goal, &correctors);
    let rank = nominal.gram.rank();
    let mut left_out = None;
    let linear = LinearColumns::new(nominal.linear, correctors.linear().len());
    let mut corrected = *state;
    let mut first = *state;
    let mut iterations = 0;
    loop {
        let mut miss = goal.miss(chain, &actual_pose(chain, source, &corrected));
        let mut columns = Columns::at(chain, &corrected, &goal, &correctors);
        let axis = goal.normal_components(&miss.axis);
        // The part of the tool-axis error that is not corrected is determined once, at the command.
        let left_out = *left_out.get_or_insert_with(|| axis - nominal.gram.corrected(&axis));
        let (weighted, seen_rad) = columns.gram.solve(rank, &(axis - left_out));
        let linear = linear.at(columns.linear);
        let seen_mm = linear.seen_mm(&linear.shares(&miss.position_mm));
        let done =
            seen_rad <= options.axis_tolerance_rad && seen_mm <= options.position_tolerance_mm;
        if done || iterations >= options.max_iterations {
            if !done && size(&first, state) > size(&corrected, state) {
                corrected = first;
                miss = goal.miss(chain, &actual_pose(chain, source, &corrected));
            }
            return Correction {
                delta: PerAxis::from_fn(|i| corrected.q[i] - state.q[i]),
                residual_mm: miss.position_mm,
                residual_axis: miss.axis,
                iterations,
                converged: done,
                tool_axis_partial: nominal.gram.is_singular(),
                near_singular: correctors.rotary().len() >= 2 && nominal.gram.is_near_singular(),
            };
        }
        iterations += 1;
        for &(index, column) in &columns.rotary {
            corrected.q[index] -= column.dot(&weighted);
        }
        if !columns.rotary.is_empty() {
            miss = goal.miss(chain, &actual_pose(chain, source, &corrected));
            columns = Columns::at(chain, &corrected, &goal, &correctors);
        }
        let shares = linear.at(columns.linear).shares(&miss.position_mm);
        for (&index, share) in correctors.linear().iter().zip(shares) {
            corrected.q[index] -= share;
        }
        if iterations == 1 {
            first = corrected;
        }
    }
}

/// Largest absolute displacement of any axis between two states, mm or rad.
fn size(a: &State, b: &State) -> f64 {
    let ways = a.q.iter().zip(&b.q).map(|(a, b)| (a - b).abs());
    ways.fold(0.0, f64::max)
}

struct Goal {
    tip_mm: Vector3<f64>,
    axis: Vector3<f64>,
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
        Self { tip_mm: pose.transform_point(&chain.tool_tip_mm()), axis, normals: normals(&axis) }
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

/// Derivatives of the tool tip and of the tool axis with respect to each correcting axis of the ideal chain, in
/// workpiece axes.
struct Columns {
    /// Chain index and column of each rotary axis: the rotation of the tool axis along its two normals, rad per rad.
    rotary: ArrayVec<(usize, Vector2<f64>), MAX_AXES>,
    gram: RotaryGram,
    /// Displacement of the tool tip by each linear axis, mm per mm in workpiece axes, in the order of the correctors.
    linear: [Vector3<f64>; 3],
}

impl Columns {
    fn at(chain: &Chain, state: &State, goal: &Goal, correctors: &Correctors) -> Self {
        let tool_axis = chain.ideal_pose(state).rotation * chain.tool_axis();
        let mut columns = Self {
            rotary: ArrayVec::new(),
            gram: RotaryGram::default(),
            linear: [Vector3::zeros(); 3],
        };
        let mut before = Pose::identity();
        for (index, (joint, &q)) in chain.joints().iter().zip(&state.q).enumerate() {
            let direction = before.rotation * joint.direction;
            if correctors.rotary().contains(&index) {
                let column = goal.normal_components(&direction.cross(&tool_axis));
                columns.gram.add(&column);
                columns.rotary.push((index, column));
            }
            let place = correctors.linear().iter().position(|&place| place == index);
            if let Some(column) = place.and_then(|place| columns.linear.get_mut(place)) {
                *column = direction;
            }
            before = before * joint.motion(q);
        }
        columns
    }
}
