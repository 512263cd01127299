//! The error of the tool at places of the working space: the body diagonals of ISO 230-6, and grids for maps.

use std::collections::BTreeMap;

use volcomp_kinematics::{Chain, ErrorSource, State, actual_pose, vector_from_rotation};
use volcomp_vocabulary::{AxisKind, AxisName, PerAxis};

use crate::{error::ModelError, machine::Machine};

const MOST_TARGETS: usize = 1_000_000;

/// One body diagonal of ISO 230-6: the deviation along it.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Diagonal {
    /// `PPP`, `NPP`, `PNP`, `PPN`: the directions of motion of X, Y, Z.
    #[serde(skip)]
    pub name: &'static str,
    /// The targets, mm and deg.
    pub at: Vec<BTreeMap<AxisName, f64>>,
    /// Deviation along the diagonal at each target, µm, zero at the first.
    pub deviation_um: Vec<f64>,
    /// Largest minus smallest deviation, µm.
    pub range_um: f64,
}

/// Default number of targets on a body diagonal.
pub const DIAGONAL_TARGETS: u32 = 20;
/// The body diagonals of ISO 230-6 by the directions of motion of X, Y, Z: `P` from the lower to the upper end of travel.
pub const BODY_DIAGONALS: [&str; 4] = ["PPP", "NPP", "PNP", "PPN"];

/// The targets of the four body diagonals over the travels of X, Y and Z, with the name of the diagonal, in the order of
/// [`BODY_DIAGONALS`]: `points` (at least 2) equidistant targets on each, both ends included. All other axes are at `others` (mm or deg;
/// default 0).
///
/// # Errors
/// [`ModelError::NoSuchAxis`] if X, Y or Z is missing, [`ModelError::TooMany`] for more than 1 000 000 targets, and the errors of
/// [`Machine::state`] for `others`.
pub fn diagonal_targets(
    machine: &Machine,
    points: usize,
    others: &[(AxisName, f64)],
) -> Result<[(&'static str, Vec<State>); 4], ModelError> {
    let mut linear = [(0, [0.0; 2]); 3];
    for (place, name) in linear.iter_mut().zip([AxisName::X, AxisName::Y, AxisName::Z]) {
        let index = machine.index_of(name)?;
        *place = (index, machine.axes()[index].travel);
    }
    let others = machine.state(others)?;
    if points > MOST_TARGETS {
        return Err(ModelError::TooMany {
            what: "targets on a diagonal",
            found: points,
            most: MOST_TARGETS,
        });
    }
    let points = points.max(2);
    Ok(BODY_DIAGONALS.map(|name| {
        let target = |index: usize| {
            let share = index as f64 / (points - 1) as f64;
            let mut state = others;
            for (&(axis, [low, high]), sense) in linear.iter().zip(name.chars()) {
                let (from, to) = if sense == 'P' { (low, high) } else { (high, low) };
                state.q[axis] = from + (to - from) * share;
            }
            state
        };
        (name, (0..points).map(target).collect())
    }))
}

/// Deviations along the four body diagonals over the travels of X, Y and Z, with all other axes at `others` (mm or deg; default 0): the error of
/// the tip (actual − ideal) along the ideal diagonal, minus its value at the first target.
///
/// `errors` may belong to this machine or to another. `command` maps a target to the commanded state: the target itself, or the target plus
/// a correction. `points` is the number of targets, both ends included, at least 2.
///
/// # Errors
/// See [`diagonal_targets`].
pub fn diagonals<S: ErrorSource>(
    machine: &Machine,
    errors: &S,
    points: usize,
    others: &[(AxisName, f64)],
    command: impl Fn(&State) -> State,
) -> Result<[Diagonal; 4], ModelError> {
    let chain = machine.chain();
    let tip = |state: &State| chain.ideal_tip_mm(state);
    let diagonal = |(name, targets): (&'static str, Vec<State>)| {
        let ends = targets.first().zip(targets.last());
        let unit = ends
            .and_then(|(from, to)| (tip(to) - tip(from)).try_normalize(0.0))
            .unwrap_or_default();
        let along_um = |ideal: &State| {
            let actual = actual_pose(chain, errors, &command(ideal))
                .transform_point(&chain.tool_tip_mm())
                - chain.workpiece_origin_mm();
            (actual - tip(ideal)).dot(&unit) * 1e3
        };
        let along_um: Vec<f64> = targets.iter().map(along_um).collect();
        let first = along_um.first().copied().unwrap_or(0.0);
        let deviation_um: Vec<f64> = along_um.iter().map(|value| value - first).collect();
        let range_um = range(&deviation_um);
        let at = targets.iter().map(|target| machine.coordinates(target));
        Diagonal { name, at: at.collect(), deviation_um, range_um }
    };
    Ok(diagonal_targets(machine, points, others)?.map(diagonal))
}

fn range(values: &[f64]) -> f64 {
    let largest = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let smallest = values.iter().copied().fold(f64::INFINITY, f64::min);
    largest - smallest
}

/// The state with a correction (mm and rad) added; the direction of approach is unchanged.
pub fn corrected(state: &State, delta: &PerAxis<f64>) -> State {
    State { q: PerAxis::from_fn(|index| state.q[index] + delta[index]), approach: state.approach }
}

/// Position (mm) and rotation (rad) of the tool at a `command`, with the errors, relative to the ideal machine at the `target`, in workpiece axes and to
/// all orders.
pub fn residual(
    chain: &Chain,
    errors: &impl ErrorSource,
    command: &State,
    target: &State,
) -> [f64; 6] {
    let [found, ideal] = [actual_pose(chain, errors, command), chain.ideal_pose(target)];
    let tip = chain.tool_tip_mm();
    let position = found.transform_point(&tip) - ideal.transform_point(&tip);
    let rotation = vector_from_rotation(&(found.rotation * ideal.rotation.transpose()));
    let ([x, y, z], [a, b, c]): ([f64; 3], [f64; 3]) = (position.into(), rotation.into());
    [x, y, z, a, b, c]
}

/// A correction rounded to a controller's resolution: `mm` for linear and `rad` for rotary axes. A resolution of 0 or
/// less leaves the correction unrounded.
pub fn quantised(machine: &Machine, delta: &PerAxis<f64>, mm: f64, rad: f64) -> PerAxis<f64> {
    let mut rounded = *delta;
    for (place, joint) in rounded.iter_mut().zip(machine.chain().joints()) {
        let step = match joint.kind {
            AxisKind::Linear => mm,
            AxisKind::Rotary => rad,
        };
        if step > 0.0 {
            *place = (*place / step).round() * step;
        }
    }
    rounded
}

const MOST_NODES: usize = 1_000_000;

/// A grid over the travels of the machine's axes X, Y and Z; all other axes are at fixed coordinates.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct MapGrid {
    /// The axes of the grid, in the order X, Y, Z.
    pub axes: Vec<AxisName>,
    /// Nodes along each axis, mm.
    pub nodes_mm: Vec<Vec<f64>>,
    /// Coordinates of the other axes, mm or deg; axes not listed are at 0.
    pub others: Vec<(AxisName, f64)>,
}

impl MapGrid {
    /// A grid of `counts` nodes over the travels of X, Y and Z, both ends included; an axis that the machine lacks is
    /// omitted. A count of 1 gives the middle of the travel. `others` are the coordinates of the other axes, mm or deg.
    ///
    /// # Errors
    /// [`ModelError::TooMany`]: more than 1 000 000 nodes along an axis; and the errors of [`Machine::state`] for
    /// `others`.
    pub fn over_travels(
        machine: &Machine,
        counts: [usize; 3],
        others: &[(AxisName, f64)],
    ) -> Result<Self, ModelError> {
        machine.state(others)?;
        let (mut axes, mut nodes_mm) = (Vec::new(), Vec::new());
        for (name, count) in [AxisName::X, AxisName::Y, AxisName::Z].into_iter().zip(counts) {
            if count > MOST_NODES {
                return Err(ModelError::TooMany {
                    what: "nodes along an axis",
                    found: count,
                    most: MOST_NODES,
                });
            }
            if let Some(axis) = machine.axis(name) {
                axes.push(name);
                nodes_mm.push(spread(axis.travel, count));
            }
        }
        Ok(Self { axes, nodes_mm, others: others.to_vec() })
    }

    /// The number of nodes of the whole grid.
    pub fn len(&self) -> usize {
        let lengths = self.nodes_mm.iter().map(Vec::len);
        lengths.fold(1, usize::saturating_mul)
    }

    /// Whether the grid is empty, because one of its axes has no node.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A node by its index, X fastest: its coordinates along X, Y and Z (mm; 0 for a missing axis) and its state. Indices from
    /// [`len`](Self::len) on wrap around.
    pub fn node(&self, machine: &Machine, mut index: usize) -> ([f64; 3], State) {
        let mut at_mm = [0.0; 3];
        // `others` was checked for the machine of the grid. For a machine without one of these axes, all other axes are
        // at 0.
        let mut state = machine.state(&self.others).unwrap_or_default();
        for ((place, name), nodes) in at_mm.iter_mut().zip(&self.axes).zip(&self.nodes_mm) {
            let count = nodes.len().max(1);
            *place = nodes.get(index % count).copied().unwrap_or_default();
            index /= count;
            if let Some(axis) = machine.chain().structure().index_of(*name) {
                state.q[axis] = *place;
            }
        }
        (at_mm, state)
    }
}

fn spread([low, high]: [f64; 2], count: usize) -> Vec<f64> {
    match count {
        0 => Vec::new(),
        1 => vec![0.5 * (low + high)],
        _ => {
            let step = |index: usize| index as f64 / (count - 1) as f64;
            (0..count).map(|index| low + (high - low) * step(index)).collect()
        }
    }
}
