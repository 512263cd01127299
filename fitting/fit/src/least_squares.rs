use nalgebra::{DMatrix, DVector};

use crate::readings::Target;

pub(crate) struct Solution {
    pub(crate) coefficients: Vec<f64>,
    /// Diagonal of the hat matrix for the mean reading of each target, weighted by its number of readings.
    pub(crate) leverages: Vec<f64>,
    /// Mean reading minus curve, for each target.
    pub(crate) residuals: Vec<f64>,
}

/// Least-squares fit to the mean readings of targets, by Householder QR. Each mean is weighted by its number of
/// readings, so the coefficients equal those of a fit to all readings, and the leverages describe the effect of leaving
/// a target out with all its readings. One factorisation gives the solutions for all leading columns.
pub(crate) struct Nested {
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    /// Qᵀ times the right-hand side.
    turned: DVector<f64>,
    roots: Vec<f64>,
    means: Vec<f64>,
}

impl Nested {
    /// Factorises `matrix`, which has one row for each target and one column for each function.
    pub(crate) fn new(mut matrix: DMatrix<f64>, targets: &[Target]) -> Self {
        let roots: Vec<f64> = targets.iter().map(|t| t.count.sqrt()).collect();
        for (mut row, &root) in matrix.row_iter_mut().zip(&roots) {
            row *= root;
        }
        let means: Vec<f64> = targets.iter().map(|t| t.mean).collect();
        let right = DVector::from_iterator(
            means.len(),
            means.iter().zip(&roots).map(|(mean, root)| mean * root),
        );
        let qr = matrix.qr();
        let (q, r) = (qr.q(), qr.r());
        let turned = q.tr_mul(&right);
        Self { q, r, turned, roots, means }
    }

    /// Solution with the first `columns` columns; `None` if these columns are linearly dependent, or more than there
    /// are targets.
    pub(crate) fn solution(&self, columns: usize) -> Option<Solution> {
        if columns > self.r.nrows() || columns > self.r.ncols() || columns == 0 {
            return None;
        }
        let r = self.r.view((0, 0), (columns, columns));
        let diagonal = r.diagonal().abs();
        if diagonal.min() <= 1e-13 * diagonal.max() {
            return None;
        }
        let coefficients = r.solve_upper_triangular(&self.turned.rows(0, columns))?;
        let q = self.q.columns(0, columns);
        let fitted = q * self.turned.rows(0, columns);
        let left = fitted.iter().zip(&self.roots).zip(&self.means);
        Some(Solution {
            coefficients: coefficients.as_slice().to_vec(),
            leverages: q.row_iter().map(|row| row.norm_squared()).collect(),
            residuals: left.map(|((fit, root), mean)| mean - fit / root).collect(),
        })
    }
}
