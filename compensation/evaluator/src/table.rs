//! The table of the errors of an axis: six piecewise cubics over one coordinate, and bilinear patches over two.
//!
//! A uniform index over the breakpoints finds the interval of a coordinate in one bounded step.

use alloc::vec::Vec;

use volcomp_kinematics::{Chain, nalgebra::Vector3};
use volcomp_vocabulary::{AxisName, Component};

use crate::{EvaluatorError, error::no_axis};

/// Number of components of a twist: three translations, three rotations.
pub(crate) const LANES: usize = 6;
/// Number of lanes of a vector register to which the components are padded.
pub(crate) const WIDE: usize = 8;
/// Maximum number of pieces of a table, which then takes 1 MiB.
pub(crate) const MAX_PIECES: usize = (1 << 20) / size_of::<Piece>();

/// Cubics of all components over one interval: c0, c1, c2, c3, each a cache line with the components side by side. The
/// two spare lanes of the first row hold the start and the end of the interval.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub(crate) struct Piece {
    rows: [[f64; WIDE]; 4],
}

impl Piece {
    /// A piece from its coefficients of powers of the distance from `start`; `end` is the start of the next piece.
    pub(crate) fn new(start: f64, end: f64, powers: [[f64; LANES]; 4]) -> Self {
        let mut rows = [[0.0; WIDE]; 4];
        for (row, power) in rows.iter_mut().zip(powers) {
            row[..LANES].copy_from_slice(&power);
        }
        rows[0][LANES] = start;
        rows[0][LANES + 1] = end;
        Self { rows }
    }

    /// A piece of zero length at `x`, constant up to infinity on one side.
    pub(crate) fn held(x: f64, value: [f64; LANES]) -> Self {
        let nothing = [0.0; LANES];
        Self::new(x, x, [value, nothing, nothing, nothing])
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

    /// Adds `slope_mm` per unit of the coordinate to the displacements.
    pub(crate) fn add_slope(&mut self, slope_mm: &Vector3<f64>) {
        let start = self.start();
        for lane in 0..3 {
            self.rows[0][lane] += slope_mm[lane] * start;
            self.rows[1][lane] += slope_mm[lane];
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Head {
    index: Uniform,
    from_piece: u32,
    pieces: u32,
}

/// All tables of a machine: pieces and the uniform indices over them. The first and the last piece of a table extend to
/// infinity.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Tables {
    cells: Vec<Cell>,
    pieces: Vec<Piece>,
}

pub(crate) trait Registers: Copy {
    /// Values of all components of a table at `x`; the two padding lanes are undefined.
    fn value(self, tables: &Tables, head: &Head, x: f64) -> [f64; WIDE];

    fn sum(self, a: &[f64; WIDE], b: &[f64; WIDE]) -> [f64; WIDE];

    /// `a`·`b` + `c`, as one fused multiply-add if the processor has this instruction.
    fn mul_add(self, a: f64, b: f64, c: f64) -> f64;
}

#[derive(Clone, Copy)]
pub(crate) struct Baseline;

impl Registers for Baseline {
    #[inline(always)]
    fn value(self, tables: &Tables, head: &Head, x: f64) -> [f64; WIDE] {
        let (piece, t) = tables.piece(head, x);
        let [c0, c1, c2, c3] = &piece.rows;
        core::array::from_fn(|lane| c0[lane] + t * (c1[lane] + t * (c2[lane] + t * c3[lane])))
    }

    #[inline(always)]
    fn sum(self, a: &[f64; WIDE], b: &[f64; WIDE]) -> [f64; WIDE] {
        core::array::from_fn(|lane| a[lane] + b[lane])
    }

    #[inline(always)]
    fn mul_add(self, a: f64, b: f64, c: f64) -> f64 {
        a * b + c
    }
}

#[cfg(feature = "std")]
#[derive(Clone, Copy)]
pub(crate) struct Wide<S>(pub(crate) S);

#[cfg(feature = "std")]
impl<S: pulp::Simd> Registers for Wide<S> {
    #[inline(always)]
    fn value(self, tables: &Tables, head: &Head, x: f64) -> [f64; WIDE] {
        let simd = self.0;
        let (piece, t) = tables.piece(head, x);
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

    #[inline(always)]
    fn sum(self, a: &[f64; WIDE], b: &[f64; WIDE]) -> [f64; WIDE] {
        let mut sum = [0.0; WIDE];
        let registers = S::as_mut_simd_f64s(&mut sum).0;
        let (a, b) = (S::as_simd_f64s(a).0, S::as_simd_f64s(b).0);
        for (lane, register) in registers.iter_mut().enumerate() {
            *register = self.0.add_f64s(a[lane], b[lane]);
        }
        sum
    }

    #[inline(always)]
    fn mul_add(self, a: f64, b: f64, c: f64) -> f64 {
        // Every x86 processor with four lanes has fused multiply-add; on others `mul_add` would be a function call.
        if cfg!(any(target_arch = "x86_64", target_arch = "x86")) && S::F64_LANES >= 4 {
            a.mul_add(b, c)
        } else {
            a * b + c
        }
    }
}

impl Tables {
    /// Adds a table from its pieces, at least two. Each piece begins where the previous one ends. The first and the
    /// last piece have zero length and extend to infinity.
    #[expect(clippy::cast_possible_truncation, reason = "4096 pieces a table at most")]
    pub(crate) fn add(&mut self, pieces: &[Piece]) -> Head {
        let breakpoints: Vec<f64> = pieces[1..].iter().map(Piece::start).collect();
        let from_piece = self.pieces.len();
        self.pieces.extend(pieces);
        Head {
            index: Uniform::add(&mut self.cells, &breakpoints, from_piece),
            from_piece: from_piece as u32,
            pieces: pieces.len() as u32,
        }
    }

    pub(crate) fn pieces(&self, head: &Head) -> &[Piece] {
        &self.pieces[head.from_piece as usize..][..head.pieces as usize]
    }

    pub(crate) fn len(&self) -> usize {
        self.pieces.len()
    }

    pub(crate) fn bytes(&self) -> usize {
        size_of_val(&self.pieces[..]) + size_of_val(&self.cells[..])
    }

    /// The piece at `x` and the distance from its start.
    #[inline(always)]
    fn piece(&self, head: &Head, x: f64) -> (&Piece, f64) {
        let cell = &self.cells[head.index.cell(x)];
        let mut place = cell.first as usize + usize::from(x >= cell.split);
        for _ in 0..cell.more {
            place += usize::from(x >= self.pieces[place].end());
        }
        let piece = &self.pieces[place];
        (piece, x - piece.start())
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Bounds {
    /// Maximum |slope| of each component, at the reference point of the axis instead of the tool tip, without the
    /// constant slope.
    pub(crate) slopes: [f64; LANES],
    /// Bound on the displacement of the tool tip, mm.
    pub(crate) linear_mm: f64,
    /// Bound on the tilt, rad.
    pub(crate) angular_rad: f64,
}

impl Bounds {
    /// Bounds over `pieces`, which state the errors at the tool tip. `arm_mm` leads from the reference point of the
    /// axis to the tool tip at machine zero; `slide` is the constant slope.
    pub(crate) fn of<'a>(
        pieces: impl Iterator<Item = &'a Piece>,
        arm_mm: &Vector3<f64>,
        slide: &Vector3<f64>,
    ) -> Self {
        let mut bounds = Self::default();
        for piece in pieces {
            bounds.take_slopes(piece, arm_mm, slide);
            bounds.take_sizes(piece);
        }
        bounds
    }

    fn take_slopes(&mut self, piece: &Piece, arm_mm: &Vector3<f64>, slide: &Vector3<f64>) {
        let length = piece.end() - piece.start();
        let power = |k: usize| {
            let row = piece.power(k);
            let tilt = Vector3::new(row[3], row[4], row[5]);
            let mut linear = Vector3::new(row[0], row[1], row[2]) - tilt.cross(arm_mm);
            if k == 1 {
                linear -= slide;
            }
            [linear.x, linear.y, linear.z, tilt.x, tilt.y, tilt.z]
        };
        let (c1, c2, c3) = (power(1), power(2), power(3));
        for (lane, bound) in self.slopes.iter_mut().enumerate() {
            let (c1, c2, c3) = (c1[lane], c2[lane], c3[lane]);
            let slope = |t: f64| libm::fabs(c1 + t * (2.0 * c2 + t * 3.0 * c3));
            let turning = -c2 / (3.0 * c3);
            let inside = (0.0..=length).contains(&turning);
            let between = if inside { slope(turning) } else { 0.0 };
            *bound = bound.max(slope(0.0)).max(slope(length)).max(between);
        }
    }

    /// Raises the bounds of displacement and tilt to those of a piece: the sum of its absolute power terms at its end.
    fn take_sizes(&mut self, piece: &Piece) {
        let length = piece.end() - piece.start();
        let sizes: [f64; LANES] = core::array::from_fn(|lane| {
            let size = |k: usize| libm::fabs(piece.power(k)[lane]);
            size(0) + length * (size(1) + length * (size(2) + length * size(3)))
        });
        let [x, y, z, a, b, c] = sizes;
        self.linear_mm = self.linear_mm.max(Vector3::new(x, y, z).norm());
        self.angular_rad = self.angular_rad.max(Vector3::new(a, b, c).norm());
    }
}

/// One component of an axis over two coordinates: bilinear between nodes, constant outside.
#[derive(Clone, Debug, PartialEq)]
pub struct Patch {
    /// The component of the axis.
    pub component: Component,
    /// Factors on the values for forward travel, backward travel, and an unknown direction of the axis to which the
    /// error belongs.
    pub weights: [f64; 3],
    /// The two axes whose coordinates the error depends on.
    pub axes: [AxisName; 2],
    /// Nodes along each of the two axes, ascending, mm or deg; at least one.
    pub nodes: [Vec<f64>; 2],
    /// Values at all nodes, mm or rad; the node of the second axis varies fastest.
    pub values: Vec<f64>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CompiledPatch {
    pub(crate) patch: Patch,
    /// The chain indices of the two axes.
    pub(crate) looked_at: [usize; 2],
    places: [Places; 2],
}

#[derive(Clone, Debug, PartialEq)]
struct Places {
    index: Uniform,
    cells: Vec<Cell>,
    /// Start of each segment and the inverse of its length.
    segments: Vec<[f64; 2]>,
}

impl CompiledPatch {
    /// Creates the compiled form of a checked `patch`; `looked_at` are the chain indices of its axes.
    pub(crate) fn new(patch: Patch, looked_at: [usize; 2]) -> Self {
        Self { looked_at, places: patch.nodes.each_ref().map(|nodes| Places::new(nodes)), patch }
    }

    pub(crate) fn value(&self, at: [f64; 2]) -> f64 {
        let (i, s) = self.places[0].place(at[0]);
        let (j, t) = self.places[1].place(at[1]);
        let columns = self.patch.nodes[1].len();
        // A single node along an axis is its own neighbour.
        let down = if self.patch.nodes[0].len() > 1 { columns } else { 0 };
        let right = usize::from(columns > 1);
        let from = i * columns + j;
        let node = |place: usize| self.patch.values.get(place).copied().unwrap_or(0.0);
        let row = |start: usize| {
            let (left, right) = (node(start), node(start + right));
            left + (right - left) * t
        };
        let (upper, lower) = (row(from), row(from + down));
        upper + (lower - upper) * s
    }
}

impl CompiledPatch {
    pub(crate) fn of(patch: Patch, chain: &Chain) -> Result<Self, EvaluatorError> {
        let [first, second] = patch.axes;
        let place = |axis: AxisName| {
            let index = chain.structure().index_of(axis);
            index.ok_or_else(|| no_axis(chain, axis))
        };
        Ok(Self::new(patch, [place(first)?, place(second)?]))
    }
}

impl Places {
    /// Creates the segments between `nodes` (ascending, not empty). A single node gives one segment of zero inverse
    /// length.
    fn new(nodes: &[f64]) -> Self {
        let segment = |pair: &[f64]| [pair[0], 1.0 / (pair[1] - pair[0])];
        let mut segments: Vec<[f64; 2]> = nodes.windows(2).map(segment).collect();
        if segments.is_empty() {
            segments.push([nodes[0], 0.0]);
        }
        let mut cells = Vec::new();
        // The breakpoints of the index are the inner nodes. Without inner nodes, a breakpoint at the largest number has
        // no effect.
        let inner = nodes.get(1..nodes.len() - 1).filter(|inner| !inner.is_empty());
        let index = Uniform::add(&mut cells, inner.unwrap_or(&[f64::MAX]), 0);
        Self { index, cells, segments }
    }

    /// Segment of a coordinate, and the position in it, 0 to 1 (NaN for NaN).
    fn place(&self, x: f64) -> (usize, f64) {
        let cell = &self.cells[self.index.cell(x)];
        let mut place = cell.first as usize + usize::from(x >= cell.split);
        for _ in 0..cell.more {
            place += usize::from(self.segments.get(place + 1).is_some_and(|next| x >= next[0]));
        }
        let place = place.min(self.segments.len() - 1);
        let [start, per_length] = self.segments[place];
        let part = (x - start) * per_length;
        let part = if part < 0.0 { 0.0 } else { part };
        (place, if part > 1.0 { 1.0 } else { part })
    }
}

impl Patch {
    /// Checks all numbers; the error states the expected value of the first invalid number.
    pub(crate) fn check(&self) -> Result<(), &'static str> {
        let rises = |nodes: &[f64]| {
            nodes.iter().all(|node| node.is_finite())
                && nodes.windows(2).all(|pair| pair[0] < pair[1])
        };
        if self.nodes.iter().any(Vec::is_empty) {
            return Err("at least one node along each axis");
        }
        if !self.nodes.iter().all(|nodes| rises(nodes)) {
            return Err("finite nodes that rise along each axis");
        }
        if self.values.len() != self.nodes[0].len() * self.nodes[1].len() {
            return Err("one value for each pair of nodes");
        }
        let numbers = self.values.iter().chain(&self.weights);
        if !numbers.into_iter().all(|number| number.is_finite()) {
            return Err("finite values and weights");
        }
        Ok(())
    }

    /// The largest absolute slope along either axis, mm or rad per mm or deg.
    pub(crate) fn slope_bound(&self) -> f64 {
        let [first, second] = &self.nodes;
        let columns = second.len();
        let value = |i: usize, j: usize| self.values.get(i * columns + j).copied().unwrap_or(0.0);
        let mut bound = 0.0_f64;
        for i in 0..first.len() {
            for j in 0..columns {
                if i + 1 < first.len() {
                    let rise = value(i + 1, j) - value(i, j);
                    bound = bound.max(libm::fabs(rise / (first[i + 1] - first[i])));
                }
                if j + 1 < columns {
                    let rise = value(i, j + 1) - value(i, j);
                    bound = bound.max(libm::fabs(rise / (second[j + 1] - second[j])));
                }
            }
        }
        bound
    }
}

const MAX_CELLS: usize = 1 << 12;
/// 2⁵²: adding this constant rounds a number below 2³² to the nearest integer, which is then in the low bits of the
/// sum.
const TO_INTEGER: f64 = 4_503_599_627_370_496.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cell {
    /// First breakpoint in the cell; infinite if there is none. Interval `first` ends here.
    split: f64,
    /// Interval at the start of the cell.
    pub(crate) first: u32,
    /// Number of breakpoints in the cell after `split`.
    pub(crate) more: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Uniform {
    low: f64,
    cells_per_unit: f64,
    /// Index of the last cell, counted from the first cell of this index structure.
    last: f64,
    /// [`TO_INTEGER`] plus the position of the first cell of this index in the shared list.
    to_cell: f64,
}

impl Uniform {
    /// Appends the cells of one or more ascending breakpoints to the shared list. `first_interval` is the number of the
    /// interval below the first breakpoint.
    #[expect(clippy::cast_possible_truncation, reason = "breakpoints are counted in thousands")]
    pub(crate) fn add(cells: &mut Vec<Cell>, breakpoints: &[f64], first_interval: usize) -> Self {
        let from = cells.len();
        let (low, high) = (breakpoints[0], breakpoints[breakpoints.len() - 1]);
        let count = cells_for(breakpoints);
        let per_unit = (count - 1) as f64 / (high - low);
        let (cells_per_unit, last) = if count > 1 && per_unit.is_finite() {
            (per_unit, (count - 1) as f64)
        } else {
            (0.0, 0.0)
        };
        let uniform = Self { low, cells_per_unit, last, to_cell: TO_INTEGER + from as f64 };
        let place = |x: &f64| (uniform.cell(*x) - from, *x);
        let mut places = breakpoints.iter().map(place).peekable();
        let mut first = first_interval as u32;
        for cell in 0..count {
            let (mut split, mut inside) = (f64::INFINITY, 0);
            while let Some((_, x)) = places.next_if(|(place, _)| *place == cell) {
                split = split.min(x);
                inside += 1;
            }
            let more = u32::saturating_sub(inside, 1);
            cells.push(Cell { split, first, more });
            first += inside;
        }
        uniform
    }

    /// Index of the cell of a coordinate: monotonic; the first cell for NaN.
    #[expect(clippy::cast_possible_truncation, reason = "the last bits are wanted")]
    #[inline(always)]
    fn cell(&self, x: f64) -> usize {
        let place = (x - self.low) * self.cells_per_unit;
        let place = if place > 0.0 { place } else { 0.0 };
        let place = if place < self.last { place } else { self.last };
        // Rounds to the nearest whole number without the branches of a cast.
        (place + self.to_cell).to_bits() as u32 as usize
    }
}

/// Number of cells with which each cell has at most one breakpoint, limited to [`MAX_CELLS`].
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "capped")]
fn cells_for(breakpoints: &[f64]) -> usize {
    let widths = breakpoints.windows(2).map(|pair| pair[1] - pair[0]);
    let narrowest = widths.fold(f64::INFINITY, f64::min);
    let range = breakpoints[breakpoints.len() - 1] - breakpoints[0];
    if breakpoints.len() < 2 || narrowest <= 0.0 {
        return 1;
    }
    (libm::ceil(range / narrowest).min(MAX_CELLS as f64) as usize + 1).min(MAX_CELLS)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that the index finds the same interval as counting breakpoints.
    fn check(breakpoints: &[f64], x: f64) {
        let mut cells = Vec::new();
        let uniform = Uniform::add(&mut cells, breakpoints, 0);
        let cell = cells[uniform.cell(x)];
        let mut found = cell.first as usize + usize::from(x >= cell.split);
        for _ in 0..cell.more {
            found += usize::from(x >= breakpoints[found]);
        }
        let expected = breakpoints.iter().filter(|b| x >= **b).count();
        assert_eq!(found, expected, "{x} among {breakpoints:?}");
    }

    #[test]
    fn interval_index_equals_linear_search() {
        let even: Vec<f64> = (0..21).map(|i| f64::from(i) * 400.0 + 0.1).collect();
        let uneven: Vec<f64> = (0..40).map(|i| f64::from(i * i) * 0.37 - 5.0).collect();
        let crowded = [0.0, 1e-9, 2e-9, 3e-9, 1.0, 1000.0, 1000.0 + 1e-9];
        for breakpoints in [&even[..], &uneven, &crowded, &[3.0], &[-1.0, 1.0]] {
            for &b in breakpoints {
                for x in [b, b.next_down(), b.next_up(), b + 0.3, b - 1e6, b + 1e6] {
                    check(breakpoints, x);
                }
            }
        }
    }
}
