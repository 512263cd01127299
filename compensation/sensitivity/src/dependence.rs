//! Linear dependence of the columns of a matrix.

use nalgebra::{DMatrix, DVector};

/// A column counts as linearly dependent if no more than this fraction of its length remains after
/// projection onto the previous columns.
pub const DEPENDENT_BELOW: f64 = 1e-9;

/// Weights in a combination below this value, relative to the largest weight, are treated as
/// rounding errors.
const ROUNDING: f64 = 1e-7;

/// Rank of a matrix, and the linear combinations of its columns that are zero.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependence {
    /// Indices of the columns that are independent of the previous ones, ascending.
    pub kept: Vec<usize>,
    /// For each dependent column, the combination with previous columns that is zero: indices and weights, the
    /// dependent column last. The weights form a vector of unit length; the first one is positive.
    pub null: Vec<Vec<(usize, f64)>>,
}

impl Dependence {
    /// Number of independent columns.
    pub fn rank(&self) -> usize {
        self.kept.len()
    }

    /// Determines the dependence of the columns of `matrix`, in order; their scale does not matter. Each column is
    /// projected onto the previous ones by twofold orthogonalisation. A column of zeros depends on no other.
    pub fn of(matrix: &DMatrix<f64>) -> Self {
        let mut basis: Vec<DVector<f64>> = Vec::new();
        // Index of each column of the basis, and its coefficients in the basis, both scaled to unit length.
        let mut places: Vec<usize> = Vec::new();
        let mut triangle: Vec<Vec<f64>> = Vec::new();
        let norms: Vec<f64> = matrix.column_iter().map(|column| column.norm()).collect();
        let mut null = Vec::new();
        for (place, column) in matrix.column_iter().enumerate() {
            if norms[place] == 0.0 {
                null.push(vec![(place, 1.0)]);
                continue;
            }
            let mut rest = column / norms[place];
            let mut shares = vec![0.0; basis.len()];
            for _ in 0..2 {
                for (unit, share) in basis.iter().zip(&mut shares) {
                    let part = unit.dot(&rest);
                    rest.axpy(-part, unit, 1.0);
                    *share += part;
                }
            }
            let left = rest.norm();
            if left <= DEPENDENT_BELOW {
                let weights = weights(&triangle, &shares);
                let scaled = places.iter().zip(weights);
                let scaled = scaled.map(|(&place, weight)| (place, -weight)).chain([(place, 1.0)]);
                null.push(combination(scaled.collect(), &norms));
            } else {
                shares.push(left);
                basis.push(rest / left);
                triangle.push(shares);
                places.push(place);
            }
        }
        Self { kept: places, null }
    }
}

/// Weights of the basis columns for a vector with these components (`shares`) along the orthogonalised basis.
fn weights(triangle: &[Vec<f64>], shares: &[f64]) -> Vec<f64> {
    let mut left = shares.to_vec();
    let mut weights = vec![0.0; shares.len()];
    for (place, column) in triangle.iter().enumerate().rev() {
        // The diagonal exceeds the dependence threshold, so it is not zero.
        let weight = left[place] / column[place];
        weights[place] = weight;
        for (left, share) in left.iter_mut().zip(column) {
            *left -= weight * share;
        }
    }
    weights
}

/// Converts a combination of unit-length columns to one of the original columns, of unit length and without rounding errors.
fn combination(scaled: Vec<(usize, f64)>, norms: &[f64]) -> Vec<(usize, f64)> {
    let largest = scaled.iter().fold(0.0_f64, |most, (_, weight)| most.max(weight.abs()));
    let kept = scaled.into_iter().filter(|(_, weight)| weight.abs() > ROUNDING * largest);
    let mut weighted: Vec<(usize, f64)> =
        kept.map(|(place, weight)| (place, weight / norms[place])).collect();
    let length = weighted.iter().map(|(_, weight)| weight * weight).sum::<f64>().sqrt();
    let first = weighted.first().map_or(1.0, |(_, weight)| weight.signum());
    for (_, weight) in &mut weighted {
        *weight /= length * first;
    }
    weighted
}
