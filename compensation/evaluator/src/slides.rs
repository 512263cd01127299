//! The correction of machines without rotary axes: the directions of their axes never turn.

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

/// How the linear axes correct a position error, wherever they are.
#[derive(Clone, Debug, PartialEq)]
pub struct Slides {
    correctors: Correctors,
    shares: LinearShares,
}

impl CompiledMachine {
    /// For the axes that its corrections move; `None` where an axis turns.
    pub fn slides(&self) -> Option<Slides> {
        let mut axes = self.axes.iter();
        if axes.any(|axis| axis.joint.kind == AxisKind::Rotary) {
            return None;
        }
        let columns = linear_columns(&self.correctors, |index| {
            let axis = self.axes.get(index);
            axis.map_or(Vector3::zeros(), |axis| axis.joint.direction)
        });
        Some(Slides {
            correctors: self.correctors.clone(),
            shares: columns.solved(),
        })
    }
}

impl Slides {
    /// The correction of a state by the errors of the place to which the correction of one step leads: mm in chain order.
    /// Where it is less than half of that step the errors are none of a machine, and the step itself is given.
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
        let mut there = *state;
        let first = self.delta(&machine.evaluate_with(state, registers));
        for (q, delta) in there.q.iter_mut().zip(&first) {
            *q += delta;
        }
        let second = self.delta(&machine.evaluate_with(&there, registers));
        // With errors that grow as fast as their coordinate the second step swings back to almost nothing.
        let size =
            |delta: &PerAxis<f64>| delta.iter().fold(0.0, |most, d| libm::fabs(*d).max(most));
        if size(&second) < 0.5 * size(&first) {
            first
        } else {
            second
        }
    }

    /// The correction of an error: that of [`CompiledMachine::first_order`], mm in chain order.
    #[inline(always)]
    pub fn delta(&self, error: &Evaluation) -> PerAxis<f64> {
        let mut delta = PerAxis::ZERO;
        let position = Vector3::from(error.position_mm);
        take_position(&self.correctors, &self.shares, &position, &mut delta);
        delta
    }
}

/// The correction of one pose in registers as wide as the processor has.
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
