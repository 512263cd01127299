use nalgebra::{DMatrix, DVector};

pub(crate) struct Solution {
    pub(crate) coefficients: Vec<f64>,
    /// Diagonal of the hat matrix.
    pub(crate) leverages: Vec<f64>,
}

/// Least squares by Householder QR; none when the columns are dependent.
pub(crate) fn solve(matrix: DMatrix<f64>, right: &[f64]) -> Option<Solution> {
    if matrix.nrows() < matrix.ncols() {
        return None;
    }
    let qr = matrix.qr();
    let (q, r) = (qr.q(), qr.r());
    let diagonal = r.diagonal().abs();
    if diagonal.min() <= 1e-13 * diagonal.max() {
        return None;
    }
    let coefficients = r.solve_upper_triangular(&q.tr_mul(&DVector::from_column_slice(right)))?;
    Some(Solution {
        coefficients: coefficients.as_slice().to_vec(),
        leverages: q.row_iter().map(|row| row.norm_squared()).collect(),
    })
}
