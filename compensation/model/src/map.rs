use volcomp_kinematics::State;
use volcomp_vocabulary::AxisName;

use crate::{error::ModelError, machine::Machine};

const MOST_NODES: usize = 1_000_000;

/// A grid over the travels of the machine's axes X, Y and Z; all other axes are at fixed coordinates.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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
