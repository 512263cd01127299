//! Selection of the axes that correct.

use arrayvec::ArrayVec;
use nalgebra::Vector3;
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

use crate::{chain::Chain, error::ChainError};

/// A linear axis counts as a new direction if the component of its unit direction normal to the axes chosen before is
/// larger than this: 0.02 is an angle of 1.15°.
pub const INDEPENDENT_ABOVE: f64 = 0.02;

/// The axes that a correction moves; the others are held.
///
/// Of the linear axes that may move, at most three correct: the first in each direction. A second axis in nearly the
/// same direction (U parallel to X, or inclined by a degree) would cause large opposite displacements. All rotary axes
/// that may move correct together, with least norm.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Correctors {
    linear: ArrayVec<usize, 3>,
    rotary: ArrayVec<usize, MAX_AXES>,
}

impl Correctors {
    /// All axes of the chain may move; linear axes are chosen in the order of the chain.
    pub fn all(chain: &Chain) -> Self {
        Self::choose(chain, chain.structure().axes())
    }

    /// Only the named axes may move; linear axes are chosen in the order of the names.
    ///
    /// # Errors
    /// [`ChainError::NoSuchAxis`] for an axis that the chain does not contain.
    pub fn named(chain: &Chain, names: &[AxisName]) -> Result<Self, ChainError> {
        for &axis in names {
            if chain.structure().index_of(axis).is_none() {
                return Err(ChainError::NoSuchAxis { axis, structure: chain.structure().clone() });
            }
        }
        Ok(Self::choose(chain, names))
    }

    /// Only the named axes may move; linear axes are chosen in the order of the names. Axes that the chain does not
    /// contain are ignored.
    pub fn choose(chain: &Chain, names: &[AxisName]) -> Self {
        let (mut linear, mut rotary) = (ArrayVec::<usize, 3>::new(), ArrayVec::new());
        let mut basis = ArrayVec::<Vector3<f64>, 3>::new();
        for &name in names {
            let Some(index) = chain.structure().index_of(name) else {
                continue;
            };
            let joint = &chain.joints()[index];
            if joint.kind == AxisKind::Rotary {
                if !rotary.contains(&index) {
                    rotary.push(index); // at most nine different places, so there is room
                }
                continue;
            }
            // Directions are compared at machine zero. A rotary axis between two linear axes turns one of them relative
            // to the other; linear axes that are parallel at machine zero count as one direction.
            let mut normal = joint.direction;
            for unit in &basis {
                normal -= unit * unit.dot(&normal);
            }
            if basis.len() < 3 && normal.norm() > INDEPENDENT_ABOVE {
                basis.push(normal.normalize());
                linear.push(index);
            }
        }
        rotary.sort_unstable();
        Self { linear, rotary }
    }

    /// Chain indices of the correcting linear axes, in the order in which they were chosen.
    pub fn linear(&self) -> &[usize] {
        &self.linear
    }

    /// Chain indices of the correcting rotary axes, ascending.
    pub fn rotary(&self) -> &[usize] {
        &self.rotary
    }

    /// Keeps the rotary axes for whose chain index `keeps` returns true.
    pub fn retain_rotary(&mut self, mut keeps: impl FnMut(usize) -> bool) {
        self.rotary.retain(|place| keeps(*place));
    }

    /// Whether corrections move the axis at this chain index.
    pub fn contains(&self, axis: usize) -> bool {
        self.linear.contains(&axis) || self.rotary.contains(&axis)
    }
}
