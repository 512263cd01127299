//! Least squares for rows with four adjacent non-zero entries, by a banded QR factorisation.

/// Number of non-zero entries of a row.
pub(crate) const WIDTH: usize = 4;

/// Triangular factor R of a QR factorisation with bandwidth 4, and Qᵀ times the right-hand side, built row by row by
/// Givens rotations. Rows must be added by ascending first column, so that each new row meets at most four rows of R.
#[derive(Clone)]
pub(crate) struct Triangle {
    r: Vec<[f64; WIDTH]>,
    y: Vec<f64>,
}

impl Triangle {
    pub(crate) fn new(size: usize) -> Self {
        Self { r: vec![[0.0; WIDTH]; size], y: vec![0.0; size] }
    }

    pub(crate) fn size(&self) -> usize {
        self.r.len()
    }

    /// Rows of R, each from its diagonal entry on, with their right-hand sides.
    pub(crate) fn rows(&self) -> impl Iterator<Item = (&[f64; WIDTH], f64)> {
        self.r.iter().zip(self.y.iter().copied())
    }

    /// Adds a row whose first entry is in the column `first`.
    pub(crate) fn add(&mut self, first: usize, mut row: [f64; WIDTH], mut right: f64) {
        for (mine, y) in self.r.iter_mut().zip(&mut self.y).skip(first) {
            if row == [0.0; WIDTH] {
                return;
            }
            if row[0] != 0.0 {
                let length = mine[0].hypot(row[0]);
                let (c, s) = (mine[0] / length, row[0] / length);
                for (a, b) in mine.iter_mut().zip(&mut row) {
                    (*a, *b) = (c * *a + s * *b, c * *b - s * *a);
                }
                (*y, right) = (c * *y + s * right, c * right - s * *y);
            }
            row = [row[1], row[2], row[3], 0.0];
        }
    }

    /// Whether no diagonal entry is numerically zero.
    pub(crate) fn is_regular(&self) -> bool {
        let diagonal = || self.r.iter().map(|row| row[0].abs());
        let largest = diagonal().fold(0.0, f64::max);
        largest.is_finite() && diagonal().all(|d| d > 1e-13 * largest)
    }

    /// Solves R a = y. R must be regular.
    pub(crate) fn solution(&self) -> Vec<f64> {
        let size = self.size();
        let mut a = vec![0.0; size + WIDTH];
        for i in (0..size).rev() {
            let [diagonal, second, third, fourth] = self.r[i];
            let known = second * a[i + 1] + third * a[i + 2] + fourth * a[i + 3];
            a[i] = (self.y[i] - known) / diagonal;
        }
        a.truncate(size);
        a
    }

    /// `bᵀ (RᵀR)⁻¹ b` for a row b that starts in the column `first`. It is the entry of the row on the diagonal of the
    /// hat matrix.
    pub(crate) fn leverage(&self, first: usize, row: &[f64; WIDTH]) -> f64 {
        // Solve Rᵀ z = b from the first non-zero entry of b on.
        let mut pending = *row;
        let mut sum = 0.0;
        for mine in self.r.iter().skip(first) {
            let z = pending[0] / mine[0];
            pending =
                [pending[1] - mine[1] * z, pending[2] - mine[2] * z, pending[3] - mine[3] * z, 0.0];
            sum += z * z;
            // Further terms are below the rounding error of the sum.
            if pending.iter().all(|p| p.abs() < 1e-18 * mine[0].abs()) {
                break;
            }
        }
        sum
    }

    /// Trace of `(RᵀR)⁻¹ SᵀS` for another triangle S of the same size. It needs only the entries of the inverse within
    /// the band. These are computed from the last row to the first (M. F. Hutchinson, F. R. de Hoog, Numer. Math. 47,
    /// 1985).
    pub(crate) fn trace_with(&self, other: &Self) -> f64 {
        let size = self.size();
        // inverse[i][d] = C[i][i + d], with C = (RᵀR)⁻¹. Rows beyond the last row are zero.
        let mut inverse = vec![[0.0; WIDTH]; size + WIDTH];
        for i in (0..size).rev() {
            let r = self.r[i];
            let at = |inverse: &[[f64; WIDTH]], a: usize, b: usize| {
                let (low, high) = if a < b { (a, b) } else { (b, a) };
                inverse[low][high - low]
            };
            for d in (0..WIDTH).rev() {
                let known: f64 = (1..WIDTH).map(|l| r[l] * at(&inverse, i + l, i + d)).sum();
                let unit = if d == 0 { 1.0 / r[0] } else { 0.0 };
                inverse[i][d] = if i + d < size { (unit - known) / r[0] } else { 0.0 };
            }
        }
        let row = |(i, s): (usize, &[f64; WIDTH])| {
            let mut sum = 0.0;
            for a in 0..WIDTH {
                for b in 0..WIDTH {
                    let (low, high) = if a < b { (a, b) } else { (b, a) };
                    let c = inverse.get(i + low).map_or(0.0, |c| c[high - low]);
                    sum += s[a] * s[b] * c;
                }
            }
            sum
        };
        other.r.iter().enumerate().map(row).sum()
    }
}
