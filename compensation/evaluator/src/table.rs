//! The six errors of one axis as piecewise cubics over one coordinate.

use alloc::{vec, vec::Vec};

use volcomp_kinematics::nalgebra::Vector3;

/// Components of a twist: three translations, three rotations.
pub(crate) const LANES: usize = 6;
/// Lanes of a vector register that the components fill up to.
pub(crate) const WIDE: usize = 8;
/// Cells of the index at the most.
const MAX_CELLS: usize = 1 << 15;
/// Pieces that 1 MiB holds.
pub(crate) const MAX_PIECES: usize = (1 << 20) / size_of::<Piece>();
/// Added to a number below 2⁵¹ it leaves the nearest whole number in the last bits.
const TO_INTEGER: f64 = 4_503_599_627_370_496.0;

/// Cubics of all components over one interval: c0, c1, c2, c3, each a cache line, components side by
/// side. The two lanes that are left hold the start and the end of the interval in the first row.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Piece {
    rows: [[f64; WIDE]; 4],
}

impl Piece {
    /// A piece from its powers of the distance from `start`; `end` is where the next one begins.
    pub(crate) fn new(start: f64, end: f64, powers: [[f64; LANES]; 4]) -> Self {
        let mut rows = [[0.0; WIDE]; 4];
        for (row, power) in rows.iter_mut().zip(powers) {
            row[..LANES].copy_from_slice(&power);
        }
        rows[0][LANES] = start;
        rows[0][LANES + 1] = end;
        Self { rows }
    }

    pub(crate) fn start(&self) -> f64 {
        self.rows[0][LANES]
    }

    pub(crate) fn end(&self) -> f64 {
        self.rows[0][LANES + 1]
    }

    /// The coefficient of a power of the distance from the start, for every component.
    pub(crate) fn power(&self, power: usize) -> [f64; LANES] {
        core::array::from_fn(|lane| self.rows[power][lane])
    }
}

/// The errors of one axis in one direction: cubics between breakpoints, held outside.
///
/// A uniform index leads to the piece in one bounded step: every cell holds the first piece that
/// reaches into it and no more than `steps` breakpoints.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Table {
    low: f64,
    high: f64,
    cells_per_unit: f64,
    steps: usize,
    /// The first piece of each cell.
    first: Vec<u32>,
    pieces: Vec<Piece>,
}

/// How the components of a table are computed.
pub(crate) trait Registers: Copy {
    /// All components at `x`; the two lanes behind them mean nothing.
    fn value(self, table: &Table, x: f64) -> [f64; WIDE];
}

/// Whatever the target has for certain.
#[derive(Clone, Copy)]
pub(crate) struct Baseline;

impl Registers for Baseline {
    #[inline(always)]
    fn value(self, table: &Table, x: f64) -> [f64; WIDE] {
        table.value(x)
    }
}

/// Registers as wide as this processor has.
#[cfg(feature = "std")]
#[derive(Clone, Copy)]
pub(crate) struct Wide<S>(pub(crate) S);

#[cfg(feature = "std")]
impl<S: pulp::Simd> Registers for Wide<S> {
    #[inline(always)]
    fn value(self, table: &Table, x: f64) -> [f64; WIDE] {
        table.value_in(self.0, x)
    }
}

impl Table {
    /// A table from its pieces, one at least, each beginning where the one before ends.
    pub(crate) fn new(pieces: Vec<Piece>) -> Self {
        let (low, high) = match (pieces.first(), pieces.last()) {
            (Some(first), Some(last)) => (first.start(), last.end()),
            _ => (0.0, 0.0),
        };
        let (first, cells_per_unit, steps) = index(&pieces, high - low);
        Self {
            low,
            high,
            cells_per_unit,
            steps,
            first,
            pieces,
        }
    }

    /// The value everywhere.
    pub(crate) fn constant(value: [f64; LANES]) -> Self {
        let nothing = [0.0; LANES];
        Self::new(vec![Piece::new(
            0.0,
            0.0,
            [value, nothing, nothing, nothing],
        )])
    }

    pub(crate) fn pieces(&self) -> &[Piece] {
        &self.pieces
    }

    /// Bytes of the table.
    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.pieces[..]) + size_of_val(&self.first[..])
    }

    /// All components at `x`; the two lanes behind them mean nothing.
    #[inline(always)]
    pub(crate) fn value(&self, x: f64) -> [f64; WIDE] {
        let (piece, t) = self.piece(x);
        let [c0, c1, c2, c3] = &piece.rows;
        core::array::from_fn(|lane| c0[lane] + t * (c1[lane] + t * (c2[lane] + t * c3[lane])))
    }

    /// The same in registers as wide as the processor has.
    #[cfg(feature = "std")]
    #[inline(always)]
    pub(crate) fn value_in<S: pulp::Simd>(&self, simd: S, x: f64) -> [f64; WIDE] {
        let (piece, t) = self.piece(x);
        let t = simd.splat_f64s(t);
        let [c0, c1, c2, c3] = piece.rows.each_ref().map(|row| S::as_simd_f64s(row).0);
        let mut value = [0.0; WIDE];
        let registers = S::as_mut_simd_f64s(&mut value).0;
        for (lane, register) in registers.iter_mut().enumerate() {
            let high = simd.mul_add_e_f64s(c3[lane], t, c2[lane]);
            let middle = simd.mul_add_e_f64s(high, t, c1[lane]);
            *register = simd.mul_add_e_f64s(middle, t, c0[lane]);
        }
        value
    }

    /// The piece at `x` and the distance from its start.
    #[inline(always)]
    fn piece(&self, x: f64) -> (&Piece, f64) {
        // NaN passes through, as in the source.
        let x = if x < self.low { self.low } else { x };
        let x = if x > self.high { self.high } else { x };
        let cell = cell_of((x - self.low) * self.cells_per_unit, self.first.len() - 1);
        let mut place = self.first[cell] as usize;
        let last = self.pieces.len() - 1;
        for _ in 0..self.steps {
            place += usize::from(x >= self.pieces[place].end() && place < last);
        }
        let piece = &self.pieces[place];
        (piece, x - piece.start())
    }

    /// The largest |slope| of each component over all pieces, displacements carried back from the end
    /// of `arm_mm`.
    pub(crate) fn slope_bounds(&self, arm_mm: &Vector3<f64>) -> [f64; LANES] {
        let mut bounds = [0.0_f64; LANES];
        for piece in &self.pieces {
            let length = piece.end() - piece.start();
            let power = |k: usize| {
                let row = piece.power(k);
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

    /// A bound of each component: the sum of the largest powers of each piece.
    pub(crate) fn magnitudes(&self) -> [f64; LANES] {
        let mut most = [0.0_f64; LANES];
        for piece in &self.pieces {
            let length = piece.end() - piece.start();
            for (lane, most) in most.iter_mut().enumerate() {
                let size = |k: usize| libm::fabs(piece.power(k)[lane]);
                let bound = size(0) + length * (size(1) + length * (size(2) + length * size(3)));
                *most = most.max(bound);
            }
        }
        most
    }
}

/// The cell of a place in cells, the nearest whole number: rising with the place, and without the
/// branches of a cast.
#[expect(clippy::cast_possible_truncation, reason = "the last bits are wanted")]
#[inline(always)]
fn cell_of(place: f64, last: usize) -> usize {
    ((place + TO_INTEGER).to_bits() as u32 as usize).min(last)
}

/// The index over the pieces: first piece of each cell, cells per unit, breakpoints in the fullest
/// cell.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts of pieces and cells are capped"
)]
fn index(pieces: &[Piece], range: f64) -> (Vec<u32>, f64, usize) {
    if pieces.len() < 2 || range <= 0.0 {
        return (vec![0], 0.0, 0);
    }
    let low = pieces[0].start();
    let lengths = pieces.iter().map(|piece| piece.end() - piece.start());
    let narrowest = lengths.fold(range, f64::min);
    let wanted = libm::ceil(range / narrowest).min(MAX_CELLS as f64) as usize;
    let cells = (wanted + 1).clamp(2, MAX_CELLS);
    let cells_per_unit = (cells - 1) as f64 / range;
    let mut first = vec![0_u32; cells];
    let (mut filled, mut steps) = (0, 0);
    let (mut in_cell, mut cell_before) = (0, 0);
    for (place, piece) in pieces.iter().enumerate().skip(1) {
        // As an evaluation computes it, so that rounding falls the same way.
        let cell = cell_of((piece.start() - low) * cells_per_unit, cells - 1);
        in_cell = if cell == cell_before { in_cell + 1 } else { 1 };
        cell_before = cell;
        steps = steps.max(in_cell);
        // Cells up to this one begin inside the piece before.
        while filled < cell {
            filled += 1;
            first[filled] = (place - 1) as u32;
        }
    }
    while filled + 1 < cells {
        filled += 1;
        first[filled] = (pieces.len() - 1) as u32;
    }
    (first, cells_per_unit, steps)
}
