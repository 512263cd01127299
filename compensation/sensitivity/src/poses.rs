//! The poses over which errors are judged.

use volcomp_kinematics::{Chain, ChainError, State};
use volcomp_vocabulary::AxisName;

/// Poses of a chain: coordinates in mm and rad, in chain order.
#[derive(Clone, Debug, PartialEq)]
pub enum Poses {
    /// Every combination of the nodes of each axis.
    Grid(Vec<Vec<f64>>),
    /// Every combination of `count` evenly spaced nodes over the travel of each axis, both ends included; one node is the middle.
    Even {
        /// The travel of each axis.
        travels: Vec<[f64; 2]>,
        /// The nodes of each axis.
        count: usize,
    },
    /// One pose after another.
    List(Vec<State>),
}

impl Poses {
    /// A grid of `count` evenly spaced nodes over the travel (mm, rad) of each axis, both ends included; one node is the
    /// middle.
    ///
    /// # Errors
    /// What [`Chain::by_axis`] refuses.
    pub fn over(
        chain: &Chain,
        travels: impl IntoIterator<Item = (AxisName, [f64; 2])>,
        count: usize,
    ) -> Result<Self, ChainError> {
        let travels = chain.by_axis(travels)?;
        Ok(Self::Even {
            travels: travels[..chain.joints().len()].to_vec(),
            count,
        })
    }

    /// How many poses there are; `None` where they are more than can be counted.
    pub fn count(&self) -> Option<usize> {
        match self {
            Self::Grid(nodes) => nodes
                .iter()
                .try_fold(1_usize, |product, nodes| product.checked_mul(nodes.len())),
            Self::Even { travels, count } => travels
                .iter()
                .try_fold(1_usize, |product, _| product.checked_mul(*count)),
            Self::List(states) => Some(states.len()),
        }
    }

    /// The pose at a place: of a grid the last axis runs fastest. Beyond the end the grid begins again, and a list gives
    /// machine zero.
    pub fn state(&self, place: usize) -> State {
        let axes = match self {
            Self::List(states) => return states.get(place).copied().unwrap_or_default(),
            Self::Grid(nodes) => nodes.len(),
            Self::Even { travels, .. } => travels.len(),
        };
        let mut state = State::default();
        let mut rest = place;
        for (axis, q) in state.q.iter_mut().enumerate().take(axes).rev() {
            let count = self.nodes(axis).max(1);
            *q = self.node(axis, rest % count);
            rest /= count;
        }
        state
    }

    /// How many nodes a grid has along an axis.
    fn nodes(&self, axis: usize) -> usize {
        match self {
            Self::Grid(nodes) => nodes[axis].len(),
            Self::Even { count, .. } => *count,
            Self::List(_) => 0,
        }
    }

    /// The coordinate of a node of a grid, mm or rad.
    fn node(&self, axis: usize, place: usize) -> f64 {
        match self {
            Self::Grid(nodes) => nodes[axis].get(place).copied().unwrap_or_default(),
            Self::Even { travels, count } => {
                let [low, high] = travels[axis];
                match count {
                    0 | 1 => 0.5 * (low + high),
                    _ => low + (high - low) * place as f64 / (count - 1) as f64,
                }
            }
            Self::List(_) => 0.0,
        }
    }
}
