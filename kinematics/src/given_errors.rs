use volcomp_vocabulary::{Displacement, ErrorName, PerAxis};

use crate::{
    chain::Chain,
    error::ChainError,
    source::{ErrorMotion, ErrorSource, State},
};

/// Constant errors, one set for each axis in the order of the chain: for tables of numbers, tests, and controllers that
/// evaluate their curves elsewhere. Axes without values have no error.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GivenErrors {
    /// The error motions `E?N` of each axis, in the order of the chain.
    pub motion: PerAxis<ErrorMotion>,
    /// The location errors `E?0N` of each axis, in the order of the chain.
    pub location: PerAxis<ErrorMotion>,
    /// The assembly errors of each axis, in the order of the chain.
    pub assembly: PerAxis<ErrorMotion>,
}

impl GivenErrors {
    /// Sets one error motion `E?N` or location error `E?0N` of an axis of `chain`, in µm for the components EX, EY and
    /// EZ, in µrad for EA, EB and EC. An error leaves all values unchanged.
    ///
    /// # Errors
    /// [`ChainError::NoSuchAxis`] for an axis that the chain does not contain, [`ChainError::NotFinite`] for a value
    /// that is not finite, [`ChainError::NoEffect`] for a location error that has no effect.
    pub fn set(
        &mut self,
        chain: &Chain,
        name: ErrorName,
        um_or_urad: f64,
    ) -> Result<(), ChainError> {
        let place = chain.structure().index_of(name.axis);
        let (index, joint) =
            place.and_then(|index| Some((index, chain.joints().get(index)?))).ok_or_else(|| {
                ChainError::NoSuchAxis { axis: name.axis, structure: chain.structure().clone() }
            })?;
        if !um_or_urad.is_finite() {
            return Err(ChainError::NotFinite { error: name, found: um_or_urad });
        }
        let no_effect = joint.no_effect(name.component);
        if let Some(reason) = no_effect.filter(|_| name.location) {
            return Err(ChainError::NoEffect { error: name, reason });
        }
        let motions = if name.location { &mut self.location } else { &mut self.motion };
        let motion = &mut motions[index];
        let inside = Displacement::from_micro(name.component.kind(), um_or_urad).mm_or_rad();
        let place = name.component.mcs_index();
        if name.component.is_angular() {
            motion.angular_rad[place] = inside;
        } else {
            motion.linear_mm[place] = inside;
        }
        Ok(())
    }
}

impl ErrorSource for GivenErrors {
    #[inline]
    fn error_motion(&self, axis: usize, _state: &State) -> ErrorMotion {
        self.motion.get(axis).copied().unwrap_or_default()
    }
    #[inline]
    fn location(&self, axis: usize) -> ErrorMotion {
        self.location.get(axis).copied().unwrap_or_default()
    }
    #[inline]
    fn assembly(&self, axis: usize) -> ErrorMotion {
        self.assembly.get(axis).copied().unwrap_or_default()
    }
}
