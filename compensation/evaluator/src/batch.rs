//! Batches of scattered poses, with the widest vector instructions of the processor, on one core or on all.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use volcomp_kinematics::State;
use volcomp_vocabulary::{AxisName, Direction, PerAxis};

use crate::{error::EvaluatorError, machine::CompiledMachine, table::Wide};

/// Number of poses per unit of parallel work.
const CHUNK: usize = 4096;

impl CompiledMachine {
    /// Evaluates scattered poses on one core. `poses` holds the coordinates (mm, rad) of `axes`, pose after pose;
    /// `errors` receives ΔP (mm) and ρ (rad) of each pose. The results equal those of [`evaluate`](Self::evaluate). If
    /// `poses` and `errors` hold different numbers of poses, the smaller number is evaluated.
    ///
    /// # Errors
    /// [`EvaluatorError::AxisOrder`] if `axes` are not the axes of the machine in chain order.
    pub fn evaluate_batch(
        &self,
        axes: &[AxisName],
        poses: &[f64],
        approach: PerAxis<Option<Direction>>,
        errors: &mut [[f64; 6]],
    ) -> Result<(), EvaluatorError> {
        self.check_order(axes)?;
        self.dispatch(poses, approach, errors);
        Ok(())
    }

    fn check_order(&self, axes: &[AxisName]) -> Result<(), EvaluatorError> {
        if axes == self.chain.structure().axes() {
            return Ok(());
        }
        Err(EvaluatorError::AxisOrder {
            found: axes.to_vec(),
            structure: self.chain.structure().clone(),
        })
    }

    fn dispatch(
        &self,
        poses: &[f64],
        approach: PerAxis<Option<Direction>>,
        errors: &mut [[f64; 6]],
    ) {
        Arch::new().dispatch(Batch { machine: self, poses, approach, errors });
    }

    /// Like [`evaluate_batch`](Self::evaluate_batch), on all cores.
    ///
    /// # Errors
    /// [`EvaluatorError::AxisOrder`].
    pub fn evaluate_batch_parallel(
        &self,
        axes: &[AxisName],
        poses: &[f64],
        approach: PerAxis<Option<Direction>>,
        errors: &mut [[f64; 6]],
    ) -> Result<(), EvaluatorError> {
        self.check_order(axes)?;
        let stride = self.axes.len().max(1);
        errors
            .par_chunks_mut(CHUNK)
            .zip(poses.par_chunks(CHUNK * stride))
            .for_each(|(errors, poses)| self.dispatch(poses, approach, errors));
        Ok(())
    }
}

struct Batch<'a> {
    machine: &'a CompiledMachine,
    poses: &'a [f64],
    approach: PerAxis<Option<Direction>>,
    errors: &'a mut [[f64; 6]],
}

impl WithSimd for Batch<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let machine = self.machine;
        let registers = Wide(simd);
        let (axes, approach) = (&machine.axes[..], self.approach);
        if let (true, [a, b, c]) = (machine.three_slides, axes) {
            let (axes, [k, l, m, ..]) = ([a, b, c], approach.0);
            let (poses, _) = self.poses.as_chunks::<3>();
            for (&pose, error) in poses.iter().zip(self.errors) {
                let found = machine.three_slides(axes, [k, l, m], pose, registers);
                *error = found.into_six();
            }
            return;
        }
        let stride = axes.len().max(1);
        let mut state = State { approach, ..State::default() };
        for (pose, error) in self.poses.chunks_exact(stride).zip(self.errors) {
            state.q[..stride].copy_from_slice(pose);
            *error = machine.evaluate_with(&state, registers).into_six();
        }
    }
}
