//! Ridge regression from sums of products.

use nalgebra::{Cholesky, DMatrix, DVector};

/// Ridge regression: weights of the planned columns, and the constant.
pub(super) struct Ridge {
    pub(super) weights: Vec<f64>,
    pub(super) constant: f64,
}

impl Ridge {
    /// Sum of squared errors over the rows of some moments.
    pub(super) fn squared_error(&self, moments: &DMatrix<f64>, plan: &[usize]) -> f64 {
        // The error is v·z with v = (−constant, 1, −weights).
        let v: Vec<(usize, f64)> = [(0, -self.constant), (1, 1.0)]
            .into_iter()
            .chain(plan.iter().copied().zip(self.weights.iter().map(|w| -w)))
            .collect();
        let product =
            |&(i, a): &(usize, f64)| v.iter().map(|&(j, b)| a * b * moments[(i, j)]).sum::<f64>();
        v.iter().map(product).sum::<f64>().max(0.0)
    }
}

/// Ridge regression from moments, features scaled to unit variance; a constant feature gets the weight 0.
pub(super) fn ridge(moments: &DMatrix<f64>, plan: &[usize], penalty: f64) -> Option<Ridge> {
    let rows = moments[(0, 0)];
    let mean = |column: usize| moments[(0, column)] / rows;
    let covariance = |a: usize, b: usize| moments[(a, b)] / rows - mean(a) * mean(b);
    let weights = ridge_weights(covariance, plan, penalty)?;
    let constant = mean(1)
        - weights
            .iter()
            .zip(plan)
            .map(|(w, &column)| w * mean(column))
            .sum::<f64>();
    Some(Ridge { weights, constant })
}

/// Weights of a ridge regression of column 1 on the columns of a plan, from the covariance of any two columns; `None` if nothing moves.
pub(super) fn ridge_weights(
    covariance: impl Fn(usize, usize) -> f64,
    plan: &[usize],
    penalty: f64,
) -> Option<Vec<f64>> {
    // Movements below 1e-4 K count as none.
    let scales: Vec<f64> = plan
        .iter()
        .map(|&c| covariance(c, c).max(0.0).sqrt())
        .map(|s| if s > 1e-4 { 1.0 / s } else { 0.0 })
        .collect();
    if scales.iter().all(|scale| *scale == 0.0) {
        return None;
    }
    let correlation = DMatrix::from_fn(plan.len(), plan.len(), |i, j| {
        covariance(plan[i], plan[j]) * scales[i] * scales[j] + if i == j { penalty } else { 0.0 }
    });
    let right = DVector::from_fn(plan.len(), |i, _| covariance(plan[i], 1) * scales[i]);
    let solved = Cholesky::new(correlation)?.solve(&right);
    Some(solved.iter().zip(&scales).map(|(w, s)| w * s).collect())
}
