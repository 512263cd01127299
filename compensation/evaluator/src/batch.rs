//! Batches of scattered poses and tensor grids over the linear axes, with the widest vector instructions of the
//! processor.

use std::vec::Vec;

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use volcomp_kinematics::{State, nalgebra::Vector3};
use volcomp_vocabulary::{AxisKind, AxisName, Direction, PerAxis};

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

/// Numbers per node: ΔP (mm), ρ (rad).
const NODE: usize = 6;
/// Number of values that are computed in the cache before they are copied to the result.
const COPIED_AT_ONCE: usize = 2048;
/// Number of values that are processed together. Four nodes fill whole registers of every width.
const BLOCK: usize = 4 * NODE;

/// The error over a tensor grid of up to three linear axes, with the other axes held. To first order the error is a sum
/// of functions of one coordinate and of products of tilt and travel, so each axis is evaluated at its own nodes only.
#[derive(Clone, Debug)]
pub struct LinearGrid {
    /// Nodes of each grid axis, mm. The axes are in chain order from the workpiece.
    nodes_mm: Vec<Vec<f64>>,
    /// Contribution of each grid axis at each node with the other axes at 0: ΔP, ρ.
    adds: Vec<Vec<[f64; NODE]>>,
    directions: Vec<Vector3<f64>>,
    base: [f64; NODE],
    /// Contributions of the innermost axis, node after node, padded to whole blocks.
    row: Vec<f64>,
    /// Coordinates of the innermost axis, mm, each repeated six times, once for each number of the node.
    row_mm: Vec<f64>,
}

impl CompiledMachine {
    /// Builds a grid over linear axes, given in chain order with their nodes (mm). The other axes keep their
    /// coordinates in `held`; the approaches in `held` apply to all axes. `None` for a grid axis that is rotary,
    /// missing, repeated or out of order, for no axis or more than three axes, for an axis without nodes, or for a
    /// machine with errors over two coordinates.
    pub fn linear_grid(&self, grid: &[(AxisName, Vec<f64>)], held: &State) -> Option<LinearGrid> {
        let place = |axis: AxisName| self.chain.structure().index_of(axis);
        let grid: Vec<(usize, &Vec<f64>)> =
            grid.iter().map(|(axis, nodes)| Some((place(*axis)?, nodes))).collect::<Option<_>>()?;
        let fits = (1..=3).contains(&grid.len())
            && grid.windows(2).all(|pair| pair[0].0 < pair[1].0)
            && grid.iter().all(|(index, nodes)| {
                let linear = |a: &crate::machine::CompiledAxis| a.joint.kind == AxisKind::Linear;
                !nodes.is_empty() && self.axes.get(*index).is_some_and(linear)
            })
            && self.axes.iter().all(|axis| axis.patches.is_empty());
        if !fits {
            return None;
        }
        let mut zero = *held;
        for (index, _) in &grid {
            zero.q[*index] = 0.0;
        }
        let at = |state: &State| self.evaluate(state).into_six();
        let base = at(&zero);
        let adds: Vec<Vec<[f64; NODE]>> = grid
            .iter()
            .map(|(index, nodes)| {
                let add = |&q: &f64| {
                    let mut state = zero;
                    state.q[*index] = q;
                    let found = at(&state);
                    core::array::from_fn(|k| found[k] - base[k])
                };
                nodes.iter().map(add).collect()
            })
            .collect();
        let origin = self.chain.ideal_pose(&zero).translation_mm;
        let directions = grid
            .iter()
            .map(|(index, _)| {
                let mut moved = zero;
                moved.q[*index] = 1.0;
                self.chain.ideal_pose(&moved).translation_mm - origin
            })
            .collect();
        let (row, row_mm) = row(&adds, &grid);
        Some(LinearGrid {
            nodes_mm: grid.iter().map(|(_, nodes)| (*nodes).clone()).collect(),
            adds,
            directions,
            base,
            row,
            row_mm,
        })
    }
}

/// Contributions of the innermost axis at all its nodes, and the coordinate of the node (mm) for each number. Both are
/// padded with zeros to whole blocks.
fn row(adds: &[Vec<[f64; NODE]>], grid: &[(usize, &Vec<f64>)]) -> (Vec<f64>, Vec<f64>) {
    let (Some(adds), Some((_, nodes))) = (adds.last(), grid.last()) else {
        return (Vec::new(), Vec::new());
    };
    let mut row: Vec<f64> = adds.iter().flatten().copied().collect();
    let mut row_mm: Vec<f64> = nodes.iter().flat_map(|&q| [q; NODE]).collect();
    let whole = row.len().div_ceil(BLOCK) * BLOCK;
    row.resize(whole, 0.0);
    row_mm.resize(whole, 0.0);
    (row, row_mm)
}

impl LinearGrid {
    /// Number of nodes along each grid axis, in chain order.
    pub fn counts(&self) -> Vec<usize> {
        self.nodes_mm.iter().map(Vec::len).collect()
    }

    /// Number of nodes of the grid.
    pub fn len(&self) -> usize {
        self.nodes_mm.iter().map(Vec::len).product()
    }

    /// Always false: each axis has at least one node.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of nodes of one row: the last grid axis, which varies fastest.
    pub fn row_len(&self) -> usize {
        self.nodes_mm.last().map_or(0, Vec::len)
    }

    /// Fills `errors` with ΔP (mm) and ρ (rad) of the rows from `first_row` on, on one core: as many whole rows as
    /// `errors` holds.
    pub fn fill_rows(&self, first_row: usize, errors: &mut [f64]) {
        Arch::new().dispatch(Rows { grid: self, first_row, errors });
    }

    /// Fills `errors` (six numbers per node) with the whole grid, on all cores.
    pub fn fill_parallel(&self, errors: &mut [f64]) {
        let numbers = self.row_len() * NODE;
        // A task computes about half a megabyte: enough to outweigh its overhead, and little enough to spread the grid
        // over all cores.
        let rows = (65_536 / numbers.max(1)).max(1);
        errors
            .par_chunks_mut(rows * numbers.max(1))
            .enumerate()
            .for_each(|(chunk, errors)| self.fill_rows(chunk * rows, errors));
    }

    /// The terms common to all nodes of a row: a constant, and a slope per mm of the coordinate of the innermost axis.
    #[inline(always)]
    fn row_terms(&self, row: usize) -> ([f64; NODE], Vector3<f64>) {
        let mut sum = self.base;
        let mut tilt = Vector3::zeros();
        let outer = self.adds.len() - 1;
        let mut rest = row;
        let mut places = [0; 3];
        for axis in (0..outer).rev() {
            let count = self.adds[axis].len();
            places[axis] = rest % count;
            rest /= count;
        }
        for (axis, &place) in places[..outer].iter().enumerate() {
            let slide = tilt.cross(&self.directions[axis]) * self.nodes_mm[axis][place];
            let add = &self.adds[axis][place];
            for (k, sum) in sum.iter_mut().enumerate() {
                *sum += add[k] + if k < 3 { slide[k] } else { 0.0 };
            }
            tilt += Vector3::new(add[3], add[4], add[5]);
        }
        (sum, tilt.cross(&self.directions[outer]))
    }
}

struct Rows<'a> {
    grid: &'a LinearGrid,
    first_row: usize,
    errors: &'a mut [f64],
}

impl WithSimd for Rows<'_> {
    type Output = ();

    /// Scalar code, compiled once for each instruction set. Rows are computed in a buffer that stays in the cache, then
    /// copied in large blocks. A large copy does not read its target first, so it causes half the memory traffic of
    /// single stores.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let grid = self.grid;
        let numbers = (grid.row_len() * NODE).max(1);
        let rows_at_once = (COPIED_AT_ONCE / numbers).max(1);
        let mut buffer = std::vec![0.0; rows_at_once * numbers];
        let mut row = self.first_row;
        for target in self.errors.chunks_mut(buffer.len()) {
            let whole = target.len() / numbers * numbers;
            for buffered in buffer[..whole].chunks_exact_mut(numbers) {
                grid.fill_row(simd, row, buffered);
                row += 1;
            }
            target[..whole].copy_from_slice(&buffer[..whole]);
        }
    }
}

impl LinearGrid {
    #[inline(always)]
    fn fill_row<S: Simd>(&self, simd: S, row: usize, errors: &mut [f64]) {
        let (constant, slope) = self.row_terms(row);
        let constants: [f64; BLOCK] = core::array::from_fn(|i| constant[i % NODE]);
        let slopes: [f64; BLOCK] =
            core::array::from_fn(|i| if i % NODE < 3 { slope[i % NODE] } else { 0.0 });
        let numbers = errors.len();
        let registers = |block| S::as_simd_f64s(block).0;
        let (constant, slope) = (registers(&constants), registers(&slopes));
        let adds = self.row.chunks_exact(BLOCK).map(registers);
        let places = self.row_mm.chunks_exact(BLOCK).map(registers);
        let mut blocks = errors.chunks_exact_mut(BLOCK);
        for ((block, adds), places) in (&mut blocks).zip(adds).zip(places) {
            let block = S::as_mut_simd_f64s(block).0;
            for (i, number) in block.iter_mut().enumerate() {
                let fixed = simd.add_f64s(constant[i], adds[i]);
                *number = simd.mul_add_e_f64s(slope[i], places[i], fixed);
            }
        }
        let rest = blocks.into_remainder();
        let from = numbers - rest.len();
        for (i, number) in rest.iter_mut().enumerate() {
            *number = constants[i] + self.row[from + i] + slopes[i] * self.row_mm[from + i];
        }
    }
}
