//! Unknown approach direction of an axis before its first move, which the file does not state.
//!
//! The axis had approached from one of its two sides. In all of these rows its errors were therefore the mean of both
//! directions, plus or minus half the reversal value. The sign is described by one number for each run of the machine
//! and each axis, with mean 0 and standard uncertainty 1, in units of half the reversal value. The numbers are not
//! results: they are eliminated from the equations. The elimination leaves the other unknowns unchanged and makes the
//! equations independent again (generalised least squares, A. C. Aitken, Proceedings of the Royal Society of Edinburgh
//! 55, 1935). If the reversal value is unknown itself, each error has a separate number, and half the reversal value
//! has its identified size, or the size that its uncertainty allows.

use std::collections::BTreeMap;

use volcomp_kinematics::nalgebra::{DMatrix, DVector};

/// Run, axis, and coefficient of the unknown reversal value (`None` if the reversal value is known) to which a number belongs.
pub(crate) type Key = (usize, usize, Option<usize>);

#[derive(Clone, Debug, Default)]
pub(crate) struct Sides(BTreeMap<Key, BTreeMap<usize, f64>>);

struct Run {
    equations: Vec<usize>,
    columns: DMatrix<f64>,
}

impl Sides {
    pub(crate) fn add(&mut self, key: Key, equation: usize, by: f64) {
        *self.0.entry(key).or_default().entry(equation).or_default() += by;
    }

    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    pub(crate) fn has_unknown(&self) -> bool {
        self.0.keys().any(|(_, _, unknown)| unknown.is_some())
    }

    pub(crate) fn scale(&mut self, by: impl Fn(usize) -> f64) {
        for (equation, value) in self.0.values_mut().flatten() {
            *value *= by(*equation);
        }
    }

    /// Dense columns of all numbers, or only of the numbers of unknown reversal values, with `equations` rows.
    pub(crate) fn columns(&self, equations: usize, of_unknown: bool) -> DMatrix<f64> {
        let selected = self.0.iter().filter(|(key, _)| !of_unknown || key.2.is_some());
        let columns: Vec<DVector<f64>> = selected
            .map(|(_, column)| {
                let mut dense = DVector::zeros(equations);
                for (&equation, &by) in column {
                    dense[equation] = by;
                }
                dense
            })
            .collect();
        if columns.is_empty() {
            DMatrix::zeros(equations, 0)
        } else {
            DMatrix::from_columns(&columns)
        }
    }

    pub(crate) fn add_to(&self, residuals: &mut DVector<f64>, values: &DVector<f64>) {
        for (column, value) in self.0.values().zip(values) {
            for (&equation, by) in column {
                residuals[equation] += by * value;
            }
        }
    }

    fn runs(&self) -> Vec<Run> {
        let mut runs: BTreeMap<usize, Vec<&BTreeMap<usize, f64>>> = BTreeMap::new();
        for (key, column) in &self.0 {
            runs.entry(key.0).or_default().push(column);
        }
        let of_run = |columns: Vec<&BTreeMap<usize, f64>>| {
            let mut equations: Vec<usize> =
                columns.iter().flat_map(|c| c.keys().copied()).collect();
            equations.sort_unstable();
            equations.dedup();
            let at = |row: usize, column: usize| {
                let of_column: &BTreeMap<usize, f64> = columns[column];
                of_column.get(&equations[row]).copied().unwrap_or(0.0)
            };
            let columns = DMatrix::from_fn(equations.len(), columns.len(), at);
            Run { equations, columns }
        };
        runs.into_values().map(of_run).collect()
    }

    /// Eliminates the numbers: transforms a matrix, whose columns are derivatives or residuals, so that its rows belong
    /// to independent readings of variance 1.
    pub(crate) fn eliminate(&self, matrix: &mut DMatrix<f64>) {
        for Run { equations, columns } in self.runs() {
            // (1 + G·Gᵀ)^(-1/2) from the eigenvectors of Gᵀ·G, which are few.
            let eigen = (columns.transpose() * &columns).symmetric_eigen();
            let largest = eigen.eigenvalues.max();
            let mut own = matrix.select_rows(&equations);
            for (vector, &square) in eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues) {
                if square > 1e-12 * largest {
                    let along = &columns * vector / square.sqrt();
                    let less = 1.0 - 1.0 / (1.0 + square).sqrt();
                    let part = along.transpose() * &own * less;
                    own -= along * part;
                }
            }
            for (row, &equation) in equations.iter().enumerate() {
                matrix.row_mut(equation).copy_from(&own.row(row));
            }
        }
    }

    /// Like [`Sides::eliminate`], for a single column.
    pub(crate) fn eliminate_from(&self, column: &mut DVector<f64>) {
        let mut matrix = DMatrix::from_column_slice(column.len(), 1, column.as_slice());
        self.eliminate(&mut matrix);
        column.copy_from(&matrix.column(0));
    }

    pub(crate) fn estimate(&self, residuals: &DVector<f64>) -> DVector<f64> {
        let mut found = Vec::with_capacity(self.len());
        for Run { equations, columns } in self.runs() {
            let own = residuals.select_rows(&equations);
            let count = columns.ncols();
            let normal = columns.transpose() * &columns + DMatrix::identity(count, count);
            let right = -(columns.transpose() * own);
            // The matrix is positive definite unless a value is NaN.
            let values = normal.cholesky().map(|normal| normal.solve(&right));
            found.extend(values.unwrap_or_else(|| DVector::zeros(count)).iter());
        }
        DVector::from_vec(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elimination_equals_the_full_covariance() {
        let mut sides = Sides::default();
        for (key, equation, by) in [
            ((0, 0, None), 0, 3.0),
            ((0, 0, None), 2, -1.0),
            ((0, 1, Some(4)), 2, 0.5),
            ((0, 1, Some(4)), 3, 700.0),
            ((1, 0, None), 1, 2.0),
        ] {
            sides.add(key, equation, by);
        }
        let columns = sides.columns(5, false);
        assert_eq!(sides.columns(5, true).ncols(), 1);
        let covariance = DMatrix::identity(5, 5) + &columns * columns.transpose();
        let residuals = DVector::from_vec(vec![1.0, -2.0, 0.7, 3.0, 0.1]);
        let inverse = covariance.try_inverse().expect("positive definite");
        let expected = residuals.dot(&(inverse * &residuals));
        let mut matrix = DMatrix::from_columns(std::slice::from_ref(&residuals));
        sides.eliminate(&mut matrix);
        assert!((matrix.norm_squared() - expected).abs() < 1e-9 * expected);
        let values = sides.estimate(&residuals);
        let mut left = residuals.clone();
        sides.add_to(&mut left, &values);
        let squares = left.norm_squared() + values.norm_squared();
        assert!((squares - expected).abs() < 1e-9 * expected);
    }
}
