//! Many scattered poses: on the widest vectors the processor has, on one core or on all.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use volcomp_kinematics::{Approach, MAX_AXES, State};

use crate::{
    machine::{CompiledMachine, Evaluation},
    table::Wide,
};

/// Poses that one core takes at a time.
const CHUNK: usize = 4096;

impl CompiledMachine {
    /// Evaluates scattered poses on one core: `poses` holds the coordinates (mm, rad) of every axis,
    /// pose after pose; `errors` gets ΔP (mm) and ρ (rad) of each. The same numbers as
    /// [`evaluate`](Self::evaluate). As many as both slices hold.
    pub fn evaluate_batch(
        &self,
        poses: &[f64],
        approach: [Approach; MAX_AXES],
        errors: &mut [[f64; 6]],
    ) {
        Arch::new().dispatch(Batch {
            machine: self,
            poses,
            approach,
            errors,
        });
    }

    /// The same on all cores.
    pub fn evaluate_batch_parallel(
        &self,
        poses: &[f64],
        approach: [Approach; MAX_AXES],
        errors: &mut [[f64; 6]],
    ) {
        let stride = self.axes.len().max(1);
        errors
            .par_chunks_mut(CHUNK)
            .zip(poses.par_chunks(CHUNK * stride))
            .for_each(|(errors, poses)| self.evaluate_batch(poses, approach, errors));
    }
}

struct Batch<'a> {
    machine: &'a CompiledMachine,
    poses: &'a [f64],
    approach: [Approach; MAX_AXES],
    errors: &'a mut [[f64; 6]],
}

impl WithSimd for Batch<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let stride = self.machine.axes.len().max(1);
        let mut state = State {
            approach: self.approach,
            ..State::default()
        };
        for (pose, error) in self.poses.chunks_exact(stride).zip(self.errors) {
            let found = if self.machine.only_slides {
                self.machine.slides(pose, &self.approach, Wide(simd))
            } else {
                state.q[..stride].copy_from_slice(pose);
                self.machine.walk(&state).0
            };
            error[..3].copy_from_slice(&found.position_mm);
            error[3..].copy_from_slice(&found.rotation_rad);
        }
    }
}

/// One pose of a chain of slides.
pub(crate) fn one_pose(machine: &CompiledMachine, state: &State) -> Evaluation {
    struct One<'a>(&'a CompiledMachine, &'a State);
    impl WithSimd for One<'_> {
        type Output = Evaluation;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Evaluation {
            self.0.slides(&self.1.q, &self.1.approach, Wide(simd))
        }
    }
    Arch::new().dispatch(One(machine, state))
}
