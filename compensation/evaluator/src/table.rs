//! The six errors of one axis as piecewise cubics over one coordinate.

use alloc::{vec, vec::Vec};

use volcomp_kinematics::nalgebra::Vector3;

/// Components of a twist: three translations, three rotations.
pub(crate) const LANES: usize = 6;
/// Lanes of a vector register that the components fill up to.
pub(crate) const WIDE: usize = 8;
/// Numbers of one piece: c0, c1, c2, c3 of each component, the components side by side.
pub(crate) const PIECE: usize = 4 * LANES;
/// Numbers behind the last piece, so that a wide load of its last row stays inside.
pub(crate) const PAD: usize = WIDE - LANES;
/// Cells of the index at the most.
const MAX_CELLS: usize = 1 << 15;
/// Pieces of 192 bytes that 1 MiB holds.
pub(crate) const MAX_PIECES: usize = (1 << 20) / (PIECE * 8);

/// The errors of one axis in one direction: cubics between breakpoints, held outside.
///
/// A uniform index leads to the piece in one bounded step: every cell holds the first piece that
/// reaches into it and no more than `steps` breakpoints.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    /// Where pieces start, and the end of the last one.
    pub(crate) starts: Vec<f64>,
    /// [`PIECE`] numbers for each piece, then [`PAD`] zeros.
    pub(crate) coefficients: Vec<f64>,
    /// The first piece of each cell.
    pub(crate) first: Vec<u32>,
    cells_per_unit: f64,
    steps: usize,
}

impl Table {
    /// A table from its pieces. `starts` has one entry more than there are pieces, rising.
    pub(crate) fn new(starts: Vec<f64>, mut coefficients: Vec<f64>) -> Self {
        coefficients.resize((starts.len() - 1) * PIECE + PAD, 0.0);
        let (first, cells_per_unit, steps) = index(&starts);
        Self {
            starts,
            coefficients,
            first,
            cells_per_unit,
            steps,
        }
    }

    /// The value everywhere.
    pub(crate) fn constant(value: [f64; LANES]) -> Self {
        let mut coefficients = vec![0.0; PIECE];
        coefficients[..LANES].copy_from_slice(&value);
        Self::new(vec![0.0, 0.0], coefficients)
    }

    pub(crate) fn pieces(&self) -> usize {
        self.starts.len() - 1
    }

    /// Bytes of the table.
    pub(crate) fn bytes(&self) -> usize {
        8 * (self.starts.len() + self.coefficients.len()) + 4 * self.first.len()
    }

    /// All components at `x`; the two lanes behind them mean nothing.
    #[inline(always)]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "float to integer casts saturate; the cell is capped at the last one"
    )]
    pub(crate) fn value(&self, x: f64) -> [f64; WIDE] {
        let last_cell = self.first.len() - 1;
        let (low, high) = (self.starts[0], self.starts[self.starts.len() - 1]);
        // NaN passes through, as in the source.
        let x = if x < low { low } else { x };
        let x = if x > high { high } else { x };
        let cell = (((x - low) * self.cells_per_unit) as usize).min(last_cell);
        let mut piece = self.first[cell] as usize;
        for _ in 0..self.steps {
            // The last start is the end of the last piece: not passed.
            piece += usize::from(piece + 2 < self.starts.len() && x >= self.starts[piece + 1]);
        }
        let t = x - self.starts[piece];
        let rows = &self.coefficients[piece * PIECE..piece * PIECE + PIECE + PAD];
        let mut value = [0.0; WIDE];
        value.copy_from_slice(&rows[3 * LANES..3 * LANES + WIDE]);
        for row in [2, 1, 0] {
            let c = &rows[row * LANES..row * LANES + WIDE];
            for lane in 0..WIDE {
                value[lane] = value[lane] * t + c[lane];
            }
        }
        value
    }

    /// The largest |slope| of each component over all pieces, displacements carried back from the end
    /// of `arm_mm`.
    pub(crate) fn slope_bounds(&self, arm_mm: &Vector3<f64>) -> [f64; LANES] {
        let mut bounds = [0.0_f64; LANES];
        for (piece, ends) in self.starts.windows(2).enumerate() {
            let length = ends[1] - ends[0];
            let power = |k: usize| {
                let row = &self.coefficients[piece * PIECE + k * LANES..][..LANES];
                let tilt = Vector3::new(row[3], row[4], row[5]);
                let linear = Vector3::new(row[0], row[1], row[2]) - tilt.cross(arm_mm);
                [linear.x, linear.y, linear.z, tilt.x, tilt.y, tilt.z]
            };
            let (c1, c2, c3) = (power(1), power(2), power(3));
            for (lane, bound) in bounds.iter_mut().enumerate() {
                let (c1, c2, c3) = (c1[lane], c2[lane], c3[lane]);
                let slope = |t: f64| libm::fabs(c1 + t * (2.0 * c2 + t * 3.0 * c3));
                let turning = -c2 / (3.0 * c3);
                let inside = (0.0..=length).contains(&turning);
                let between = if inside { slope(turning) } else { 0.0 };
                *bound = bound.max(slope(0.0)).max(slope(length)).max(between);
            }
        }
        bounds
    }

    /// The largest |value| of each component at the ends and thirds of every piece.
    pub(crate) fn magnitudes(&self) -> [f64; LANES] {
        let mut most = [0.0_f64; LANES];
        for ends in self.starts.windows(2) {
            for step in 0..=3 {
                let x = ends[0] + (ends[1] - ends[0]) * f64::from(step) / 3.0;
                for (most, value) in most.iter_mut().zip(self.value(x)) {
                    *most = most.max(libm::fabs(value));
                }
            }
        }
        most
    }
}

/// The index over rising breakpoints: first piece of each cell, cells per unit, breakpoints in the
/// fullest cell.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the count of cells is capped"
)]
fn index(starts: &[f64]) -> (Vec<u32>, f64, usize) {
    let pieces = starts.len() - 1;
    let (low, range) = (starts[0], starts[pieces] - starts[0]);
    if pieces == 1 || range <= 0.0 {
        return (vec![0], 0.0, 0);
    }
    let narrowest = starts
        .windows(2)
        .map(|ends| ends[1] - ends[0])
        .fold(range, f64::min);
    let cells = (libm::ceil(range / narrowest) as usize + 1).clamp(2, MAX_CELLS);
    let cells_per_unit = cells as f64 / range;
    let mut first = vec![0_u32; cells];
    let mut filled = 0;
    let mut steps = 0;
    // The cell of a breakpoint as `value` computes it, so that rounding falls the same way.
    let cell_of = |x: f64| (((x - low) * cells_per_unit) as usize).min(cells - 1);
    let mut in_cell = 0;
    let mut cell_before = 0;
    for piece in 1..pieces {
        let cell = cell_of(starts[piece]);
        in_cell = if cell == cell_before { in_cell + 1 } else { 1 };
        cell_before = cell;
        steps = steps.max(in_cell);
        // Cells after the one in which this piece starts begin inside it.
        while filled < cell {
            filled += 1;
            first[filled] = (piece - 1) as u32;
        }
    }
    while filled + 1 < cells {
        filled += 1;
        first[filled] = (pieces - 1) as u32;
    }
    (first, cells_per_unit, steps)
}
