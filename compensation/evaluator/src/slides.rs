//! Correction of machines without rotary axes: their axis directions are the same at every pose.

#[cfg(feature = "std")]
use pulp::{Arch, Simd, WithSimd};
use volcomp_kinematics::{Correctors, State, least_norm::LinearShares, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, PerAxis};

#[cfg(not(feature = "std"))]
use crate::table::Baseline;
#[cfg(feature = "std")]
use crate::table::Wide;
use crate::{
    correction::{linear_columns, take_position},
    machine::{CompiledMachine, Evaluation},
    table::Registers,
};

/// Precomputed correction of a position error by the linear axes, valid at every pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Slides {
    correctors: Correctors,
    shares: LinearShares,
}

impl CompiledMachine {
    /// The precomputed correction for the correcting axes of the machine; `None` if the machine has a rotary axis.
    pub fn slides(&self) -> Option<Slides> {
        let mut axes = self.axes.iter();
        if axes.any(|axis| axis.joint.kind == AxisKind::Rotary) {
            return None;
        }
        let columns = linear_columns(&self.correctors, |index| {
            let axis = self.axes.get(index);
            axis.map_or(Vector3::zeros(), |axis| axis.joint.direction)
        });
        Some(Slides { correctors: self.correctors.clone(), shares: columns.solved() })
    }
}

impl Slides {
    /// The correction in two steps, mm in chain order: the second step uses the errors at the position corrected by the
    /// first. If the second result is less than half of the first, the errors are unrealistic, and the first result is
    /// returned.
    pub fn two_steps(&self, machine: &CompiledMachine, state: &State) -> PerAxis<f64> {
        #[cfg(feature = "std")]
        return two_steps(machine, state, self);
        #[cfg(not(feature = "std"))]
        self.two_steps_with(machine, state, Baseline)
    }

    #[inline(always)]
    pub(crate) fn two_steps_with(
        &self,
        machine: &CompiledMachine,
        state: &State,
        registers: impl Registers,
    ) -> PerAxis<f64> {
        let mut corrected = *state;
        let first = self.delta(&machine.evaluate_with(state, registers));
        let axes = machine.axes.len();
        for (q, delta) in corrected.q.iter_mut().zip(&first).take(axes) {
            *q += delta;
        }
        let second = self.delta(&machine.evaluate_with(&corrected, registers));
        // If an error grows as fast as its coordinate, the second step is almost zero.
        let size = |delta: &PerAxis<f64>| {
            let sizes = delta.iter().take(axes).map(|delta| libm::fabs(*delta));
            sizes.fold(0.0, |most, size| if size > most { size } else { most })
        };
        if size(&second) < 0.5 * size(&first) { first } else { second }
    }

    /// The correction of an error, as in [`CompiledMachine::first_order`]: mm in chain order.
    #[inline(always)]
    pub fn delta(&self, error: &Evaluation) -> PerAxis<f64> {
        let mut delta = PerAxis::ZERO;
        let position = Vector3::from(error.position_mm);
        take_position(&self.correctors, &self.shares, &position, &mut delta);
        delta
    }
}

#[cfg(feature = "std")]
fn two_steps(machine: &CompiledMachine, state: &State, slides: &Slides) -> PerAxis<f64> {
    struct Two<'a>(&'a CompiledMachine, &'a State, &'a Slides);
    impl WithSimd for Two<'_> {
        type Output = PerAxis<f64>;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> PerAxis<f64> {
            let Self(machine, state, slides) = self;
            slides.two_steps_with(machine, state, Wide(simd))
        }
    }
    Arch::new().dispatch(Two(machine, state, slides))
}
