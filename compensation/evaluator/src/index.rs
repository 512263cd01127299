//! Uniform index over breakpoints: finds the interval of a coordinate in one bounded step.

use alloc::vec::Vec;

const MAX_CELLS: usize = 1 << 12;
/// 2⁵²: adding this constant rounds a number below 2³² to the nearest integer, which is then in the low bits of the
/// sum.
const TO_INTEGER: f64 = 4_503_599_627_370_496.0;

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cell {
    /// First breakpoint in the cell, from which on interval `first` + 1 applies; infinite without a breakpoint.
    pub(crate) split: f64,
    /// Interval at the start of the cell.
    pub(crate) first: u32,
    /// Number of breakpoints in the cell after `split`.
    pub(crate) more: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Uniform {
    low: f64,
    cells_per_unit: f64,
    /// Number of the last cell, counted from the first cell of this index.
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
    pub(crate) fn cell(&self, x: f64) -> usize {
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
