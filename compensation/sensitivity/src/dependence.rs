//! Which columns of a matrix are combinations of others.

use nalgebra::{DMatrix, DVector};

/// A column counts as a combination of others when less than this part of it is left beside them.
pub const DEPENDENT_BELOW: f64 = 1e-9;

/// A share of a column in a combination that is smaller than this beside the largest is rounding.
const ROUNDING: f64 = 1e-7;

/// The rank of a matrix and the combinations of its columns that vanish.
#[derive(Clone, Debug, PartialEq)]
pub struct Dependence {
    /// The columns that those before them do not make up, rising.
    pub kept: Vec<usize>,
    /// For each column that is a combination of those before it, the combination that vanishes: places and weights of
    /// unit length, the first of them positive, the column itself last.
    pub null: Vec<Vec<(usize, f64)>>,
}

impl Dependence {
    /// How many columns no other columns make up.
    pub fn rank(&self) -> usize {
        self.kept.len()
    }

    /// Of the columns of `matrix` (any scale each), taken in their order: each is held against those before it by
    /// orthogonalisation done twice. A column of zeros is a combination of none.
    pub fn of(matrix: &DMatrix<f64>) -> Self {
        let mut basis: Vec<DVector<f64>> = Vec::new();
        // For each column of the basis its place, and itself in terms of the basis, both scaled to unit length.
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
                let scaled = scaled
                    .map(|(&place, weight)| (place, -weight))
                    .chain([(place, 1.0)]);
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

/// The weights of the columns of a basis in what has these shares along its orthogonal directions.
fn weights(triangle: &[Vec<f64>], shares: &[f64]) -> Vec<f64> {
    let mut left = shares.to_vec();
    let mut weights = vec![0.0; shares.len()];
    for (place, column) in triangle.iter().enumerate().rev() {
        // The diagonal is above what counts as dependent.
        let weight = left[place] / column[place];
        weights[place] = weight;
        for (left, share) in left.iter_mut().zip(column) {
            *left -= weight * share;
        }
    }
    weights
}

/// A combination of columns of unit length as one of the columns themselves, without rounding, of unit length.
fn combination(scaled: Vec<(usize, f64)>, norms: &[f64]) -> Vec<(usize, f64)> {
    let largest = scaled
        .iter()
        .fold(0.0_f64, |most, (_, weight)| most.max(weight.abs()));
    let kept = scaled
        .into_iter()
        .filter(|(_, weight)| weight.abs() > ROUNDING * largest);
    let mut weighted: Vec<(usize, f64)> = kept
        .map(|(place, weight)| (place, weight / norms[place]))
        .collect();
    let length = weighted
        .iter()
        .map(|(_, weight)| weight * weight)
        .sum::<f64>()
        .sqrt();
    // The first name counts positive.
    let first = weighted.first().map_or(1.0, |(_, weight)| weight.signum());
    for (_, weight) in &mut weighted {
        *weight /= length * first;
    }
    weighted
}
