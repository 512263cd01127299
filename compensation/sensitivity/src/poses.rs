//! Poses over which errors are evaluated.

use volcomp_kinematics::{Chain, ChainError, State};
use volcomp_vocabulary::AxisName;

/// Poses of a chain, in mm and rad, in chain order.
#[derive(Clone, Debug, PartialEq)]
pub enum Poses {
    /// Every combination of the listed nodes of each axis.
    Grid(Vec<Vec<f64>>),
    /// Every combination of `count` evenly spaced nodes over the travel of each axis, both ends included; a count of 1 gives the middle.
    Even {
        /// Travel of each axis, mm or rad.
        travels: Vec<[f64; 2]>,
        /// Number of nodes of each axis.
        count: usize,
    },
    /// The listed poses, in order.
    List(Vec<State>),
}

impl Poses {
    /// Creates a grid of `count` evenly spaced nodes over the travel (mm, rad) of each axis, both ends included; a count of 1 gives the middle.
    ///
    /// # Errors
    /// See [`Chain::by_axis`].
    pub fn over(
        chain: &Chain,
        travels: impl IntoIterator<Item = (AxisName, [f64; 2])>,
        count: usize,
    ) -> Result<Self, ChainError> {
        let travels = chain.by_axis(travels)?;
        Ok(Self::Even { travels: travels[..chain.joints().len()].to_vec(), count })
    }

    /// Number of poses; `None` if it overflows.
    pub fn count(&self) -> Option<usize> {
        match self {
            Self::Grid(nodes) => {
                nodes.iter().try_fold(1_usize, |product, nodes| product.checked_mul(nodes.len()))
            }
            Self::Even { travels, count } => {
                travels.iter().try_fold(1_usize, |product, _| product.checked_mul(*count))
            }
            Self::List(states) => Some(states.len()),
        }
    }

    /// Pose at an index; in a grid the last axis varies fastest. Beyond the end a grid wraps around, and a list returns machine zero.
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

    fn nodes(&self, axis: usize) -> usize {
        match self {
            Self::Grid(nodes) => nodes[axis].len(),
            Self::Even { count, .. } => *count,
            Self::List(_) => 0,
        }
    }

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
