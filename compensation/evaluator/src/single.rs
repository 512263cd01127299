//! Evaluation of one pose with the widest registers of the processor; without the standard library, with the registers
//! of the compilation target.

#[cfg(feature = "std")]
use pulp::{Arch, Simd, WithSimd};
use volcomp_kinematics::{Correctors, State};

#[cfg(not(feature = "std"))]
use crate::table::Baseline;
use crate::{
    correction::{CorrectionParts, FirstOrder},
    machine::{CompiledMachine, Evaluation},
};
#[cfg(feature = "std")]
use crate::{machine::CompiledAxis, table::Wide};

impl CompiledMachine {
    /// The volumetric error at a state (mm, rad), first order (the `twist` form).
    pub fn evaluate(&self, state: &State) -> Evaluation {
        #[cfg(feature = "std")]
        return one_pose(self, state);
        #[cfg(not(feature = "std"))]
        self.evaluate_with(state, Baseline)
    }

    /// The first-order correction by the axes of [`correctors`](Self::correctors): the rotary axes correct the tool direction with least
    /// norm, then the linear axes correct the position.
    pub fn first_order(&self, state: &State) -> FirstOrder {
        self.first_order_of(state, &self.correctors)
    }

    /// The first-order correction by the axes in `correctors`, for a controller that can write only some axes of the machine.
    pub fn first_order_of(&self, state: &State, correctors: &Correctors) -> FirstOrder {
        #[cfg(feature = "std")]
        return one_correction(self, state, correctors);
        #[cfg(not(feature = "std"))]
        self.first_order_with::<true>(state, correctors, Baseline)
    }

    /// The first-order correction in parts, for a controller interface that limits, ramps or rounds the rotary shares.
    /// The linear shares can then be matched to the rotary shares that are written.
    pub fn parts_of(&self, state: &State, correctors: &Correctors) -> CorrectionParts {
        #[cfg(feature = "std")]
        return one_in_parts(self, state, correctors);
        #[cfg(not(feature = "std"))]
        self.parts_with::<true>(state, correctors, Baseline)
    }
}

#[cfg(feature = "std")]
fn one_pose(machine: &CompiledMachine, state: &State) -> Evaluation {
    struct Slides<'a>(&'a CompiledMachine, [&'a CompiledAxis; 3], &'a State);
    impl WithSimd for Slides<'_> {
        type Output = Evaluation;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Evaluation {
            let Self(machine, axes, state) = self;
            let (&[x, y, z, ..], &[k, l, m, ..]) = (&state.q.0, &state.approach.0);
            machine.three_slides(axes, [k, l, m], [x, y, z], Wide(simd))
        }
    }
    struct Walk<'a, const PATCHED: bool>(&'a CompiledMachine, &'a State);
    impl<const PATCHED: bool> WithSimd for Walk<'_, PATCHED> {
        type Output = Evaluation;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Evaluation {
            self.0.walk::<PATCHED>(self.1, Wide(simd), &mut ())
        }
    }
    if let (true, [a, b, c]) = (machine.three_slides, &machine.axes[..]) {
        Arch::new().dispatch(Slides(machine, [a, b, c], state))
    } else if machine.patched {
        Arch::new().dispatch(Walk::<true>(machine, state))
    } else {
        Arch::new().dispatch(Walk::<false>(machine, state))
    }
}

/// The first-order correction of one pose, with the widest registers.
#[cfg(feature = "std")]
fn one_correction(machine: &CompiledMachine, state: &State, correctors: &Correctors) -> FirstOrder {
    struct One<'a, const PATCHED: bool>(&'a CompiledMachine, &'a State, &'a Correctors);
    impl<const PATCHED: bool> WithSimd for One<'_, PATCHED> {
        type Output = FirstOrder;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> FirstOrder {
            let Self(machine, state, correctors) = self;
            machine.first_order_with::<PATCHED>(state, correctors, Wide(simd))
        }
    }
    if machine.patched {
        Arch::new().dispatch(One::<true>(machine, state, correctors))
    } else {
        Arch::new().dispatch(One::<false>(machine, state, correctors))
    }
}

#[cfg(feature = "std")]
fn one_in_parts(
    machine: &CompiledMachine,
    state: &State,
    correctors: &Correctors,
) -> CorrectionParts {
    struct One<'a, const PATCHED: bool>(&'a CompiledMachine, &'a State, &'a Correctors);
    impl<const PATCHED: bool> WithSimd for One<'_, PATCHED> {
        type Output = CorrectionParts;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> CorrectionParts {
            let Self(machine, state, correctors) = self;
            machine.parts_with::<PATCHED>(state, correctors, Wide(simd))
        }
    }
    if machine.patched {
        Arch::new().dispatch(One::<true>(machine, state, correctors))
    } else {
        Arch::new().dispatch(One::<false>(machine, state, correctors))
    }
}
