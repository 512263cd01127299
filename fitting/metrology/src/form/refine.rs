//! Least squares of exact distances, by Levenberg–Marquardt and finally Gauss–Newton steps.

use nalgebra::{SMatrix, SVector, Vector3};

/// Surface or curve with `N` parameters.
pub(super) trait Shape<const N: usize>: Clone {
    /// Signed distance of a point, and its derivatives with respect to the parameters of [`moved`](Self::moved) at
    /// zero.
    fn distance(&self, point: &Vector3<f64>) -> (f64, SVector<f64, N>);
    fn moved(&self, by: &SVector<f64, N>) -> Self;
}

pub(super) struct Refined<S, const N: usize> {
    pub(super) shape: S,
    pub(super) squares: f64,
    /// Square root of the ratio of the smallest to the largest eigenvalue of the normal equations, after scaling each
    /// parameter to a diagonal of 1. It is 0 if the points do not determine the parameters.
    pub(super) determined: f64,
    step: f64,
}

impl<S, const N: usize> Refined<S, N> {
    pub(super) fn has_settled(&self) -> bool {
        self.step < 1e-6
    }
}

struct Normal<const N: usize> {
    matrix: SMatrix<f64, N, N>,
    gradient: SVector<f64, N>,
    squares: f64,
}

impl<const N: usize> Normal<N> {
    fn of(shape: &impl Shape<N>, points: &[Vector3<f64>]) -> Self {
        let mut sum = Self { matrix: SMatrix::zeros(), gradient: SVector::zeros(), squares: 0.0 };
        for point in points {
            let (distance, derivatives) = shape.distance(point);
            sum.matrix += derivatives * derivatives.transpose();
            sum.gradient += derivatives * distance;
            sum.squares += distance * distance;
        }
        sum
    }

    /// Solves for the step, after increasing the diagonal by the fraction `damping`.
    fn step(&self, damping: f64) -> Option<SVector<f64, N>> {
        let mut matrix = self.matrix;
        for k in 0..N {
            matrix[(k, k)] *= 1.0 + damping;
        }
        let step = -matrix.cholesky()?.solve(&self.gradient);
        step.iter().all(|x| x.is_finite()).then_some(step)
    }

    fn determined(&self) -> f64 {
        let scale = SVector::<f64, N>::from_fn(|k, _| self.matrix[(k, k)].sqrt());
        let is_seen = |x: &f64| *x > 0.0;
        if !scale.iter().all(is_seen) {
            return 0.0;
        }
        let scaled = self.matrix.component_div(&(scale * scale.transpose()));
        // The singular values of a symmetric matrix are the magnitudes of its eigenvalues.
        let values =
            nalgebra::DMatrix::from_column_slice(N, N, scaled.as_slice()).singular_values();
        (values.min() / values.max()).sqrt()
    }
}

pub(super) fn refine<S: Shape<N>, const N: usize>(
    start: S,
    points: &[Vector3<f64>],
    most_steps: usize,
) -> Refined<S, N> {
    let mut shape = start;
    let mut normal = Normal::of(&shape, points);
    let mut damping = 1e-3;
    for _ in 0..most_steps {
        let Some(step) = normal.step(damping) else {
            damping = 10.0 * f64::max(damping, 1e-12);
            if damping > 1e12 {
                break;
            }
            continue;
        };
        if step.norm() < 1e-8 {
            break;
        }
        let moved = shape.moved(&step);
        let there = Normal::of(&moved, points);
        if there.squares < normal.squares {
            (shape, normal) = (moved, there);
            damping *= 0.1;
        } else {
            damping *= 10.0;
        }
        if damping > 1e12 {
            break;
        }
    }
    // At its minimum the sum of squares is flat to half of the digits, but the gradient is not.
    let mut last = f64::INFINITY;
    for _ in 0..60 {
        let Some(step) = normal.step(0.0) else { break };
        let length = step.norm();
        let is_closing_in = length < 0.7 * last && length <= 1e-2;
        if !is_closing_in {
            break;
        }
        shape = shape.moved(&step);
        normal = Normal::of(&shape, points);
        last = length;
        if length < 1e-16 {
            break;
        }
    }
    Refined { shape, squares: normal.squares, determined: normal.determined(), step: last }
}
