//! The volumetric map: the error on a grid over the travels.

use volcomp_kinematics::State;
use volcomp_vocabulary::AxisName;

use crate::{error::ModelError, machine::Machine};

/// The most nodes along one axis.
const MOST_NODES: usize = 1_000_000;

/// A grid over the travels of those of the linear axes X, Y, Z that the machine has; all other axes stand where they are said
/// to.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct MapGrid {
    /// The axes of the grid, in the order X, Y, Z.
    pub axes: Vec<AxisName>,
    /// Nodes along each axis, mm.
    pub nodes_mm: Vec<Vec<f64>>,
    /// Where the other axes stand, mm or deg; those that are not named at 0.
    pub others: Vec<(AxisName, f64)>,
}

impl MapGrid {
    /// `counts` nodes over the travels of X, Y and Z, both ends included; an axis the machine lacks
    /// takes no part. A count of 1 stands at the middle. `others` says where the axes of the machine that are not of the grid
    /// stand, mm or deg.
    ///
    /// # Errors
    /// [`ModelError::TooMany`]: more than 1 000 000 nodes along an axis; what [`Machine::state`] refuses of `others`.
    pub fn over_travels(
        machine: &Machine,
        counts: [usize; 3],
        others: &[(AxisName, f64)],
    ) -> Result<Self, ModelError> {
        machine.state(others)?;
        let (mut axes, mut nodes_mm) = (Vec::new(), Vec::new());
        for (name, count) in [AxisName::X, AxisName::Y, AxisName::Z]
            .into_iter()
            .zip(counts)
        {
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
        Ok(Self {
            axes,
            nodes_mm,
            others: others.to_vec(),
        })
    }

    /// The number of nodes of the whole grid.
    pub fn len(&self) -> usize {
        let lengths = self.nodes_mm.iter().map(Vec::len);
        lengths.fold(1, usize::saturating_mul)
    }

    /// Whether an axis of the grid has no node, so that the grid has none.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A node by its number, X fastest: its coordinates along the axes of the grid (mm; 0 for an axis that
    /// is not there) and its state. Numbers from [`len`](Self::len) on begin again at the first node.
    pub fn node(&self, machine: &Machine, mut index: usize) -> ([f64; 3], State) {
        let mut at_mm = [0.0; 3];
        // Asked for when the grid was made; of another machine the axes stand at 0.
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
            (0..count)
                .map(|index| low + (high - low) * step(index))
                .collect()
        }
    }
}
