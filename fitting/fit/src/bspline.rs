use nalgebra::DMatrix;
use volcomp_curve::BSpline;

use crate::fit::{left_out, rms};
use crate::least_squares::{self, Solution};
use crate::{Fit, FitError, readings};

const DEGREE: usize = 3;
const MAX_SEGMENTS: usize = 40;
/// Powers of ten of the smoothing parameter tried, and the last step of the refinement.
const LOG_LAMBDA: [i32; 2] = [-9, 9];
const LOG_RESOLUTION: f64 = 0.01;

/// Fits a smoothing B-spline through the mean reading of each target: cubic, uniform knots (as many
/// segments as gaps between targets, at most 40), a penalty on second differences of the
/// coefficients (Eilers and Marx, Statistical Science 11, 1996), its weight by generalised
/// cross-validation (Craven and Wahba, Numer. Math. 31, 1979).
///
/// # Errors
/// Unequal lengths, numbers that are not finite, fewer than 4 different targets.
pub fn fit_bspline(x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
    let targets = readings::checked_targets(x, u, 4, "a smoothing spline")?;
    let knots = uniform_knots(
        targets[0][0],
        targets[targets.len() - 1][0],
        targets.len() - 1,
    );
    let basis = basis(&targets, &knots)?;
    let means: Vec<f64> = targets.iter().map(|t| t[1]).collect();

    let undetermined = FitError::Undetermined {
        coefficients: basis.ncols(),
    };
    let solution = cross_validated(&basis, &means).ok_or(undetermined)?;
    let errors = residuals(&basis, &means, &solution.coefficients);
    let errors = errors.iter().zip(&solution.leverages);
    let loo = rms(errors.map(|(&e, &h)| left_out(e, h)));
    let curve = BSpline::new(knots, solution.coefficients, DEGREE)?;
    Ok(Fit::new(curve.into(), x, u, loo))
}

fn uniform_knots(lower: f64, upper: f64, gaps: usize) -> Vec<f64> {
    let segments = gaps.min(MAX_SEGMENTS);
    let step = (upper - lower) / segments as f64;
    (0..=segments + 2 * DEGREE)
        .map(|i| match i {
            // The ends of the domain are those of the targets to the last digit.
            _ if i == DEGREE => lower,
            _ if i == DEGREE + segments => upper,
            _ => lower + (i as f64 - DEGREE as f64) * step,
        })
        .collect()
}

/// The B-splines at the targets, a column each.
fn basis(targets: &[[f64; 2]], knots: &[f64]) -> Result<DMatrix<f64>, FitError> {
    let size = knots.len() - DEGREE - 1;
    let mut basis = DMatrix::zeros(targets.len(), size);
    for k in 0..size {
        let mut unit = vec![0.0; size];
        unit[k] = 1.0;
        let spline = BSpline::new(knots.to_vec(), unit, DEGREE)?;
        for (i, target) in targets.iter().enumerate() {
            basis[(i, k)] = spline.value(target[0]);
        }
    }
    Ok(basis)
}

/// The solution whose smoothing parameter has the smallest generalised cross-validation score: a
/// search over powers of ten, then bisection of the step around the best.
fn cross_validated(basis: &DMatrix<f64>, means: &[f64]) -> Option<Solution> {
    let score = |log: f64| {
        penalised(basis, means, log).map(|solution| (generalised(basis, means, &solution), log))
    };
    let better = |a: (f64, f64), b: (f64, f64)| if b.0 < a.0 { b } else { a };
    let [first, last] = LOG_LAMBDA;
    let mut best = (first..=last)
        .filter_map(|log| score(f64::from(log)))
        .reduce(better)?;
    let mut step = 0.5;
    while step > LOG_RESOLUTION {
        let around = [best.1 - step, best.1 + step].into_iter().filter_map(score);
        best = around.fold(best, better);
        step /= 2.0;
    }
    penalised(basis, means, best.1)
}

/// Least squares with the rows of the penalty below those of the readings.
fn penalised(basis: &DMatrix<f64>, means: &[f64], log_lambda: f64) -> Option<Solution> {
    let (rows, size) = basis.shape();
    let root = 10_f64.powf(log_lambda / 2.0);
    let mut matrix = DMatrix::zeros(rows + size - 2, size);
    matrix.rows_mut(0, rows).copy_from(basis);
    for i in 0..size - 2 {
        for (k, difference) in [1.0, -2.0, 1.0].into_iter().enumerate() {
            matrix[(rows + i, i + k)] = root * difference;
        }
    }
    let mut right = means.to_vec();
    right.resize(rows + size - 2, 0.0);
    let mut solution = least_squares::solve(matrix, &right)?;
    solution.leverages.truncate(rows);
    Some(solution)
}

fn residuals(basis: &DMatrix<f64>, means: &[f64], coefficients: &[f64]) -> Vec<f64> {
    let rows = basis.row_iter().zip(means);
    rows.map(|(row, mean)| {
        mean - row
            .iter()
            .zip(coefficients)
            .map(|(b, c)| b * c)
            .sum::<f64>()
    })
    .collect()
}

/// `n Σe² / (n − tr H)²`; infinite where the spline has no freedom left, for there rounding alone
/// would decide.
fn generalised(basis: &DMatrix<f64>, means: &[f64], solution: &Solution) -> f64 {
    let count = means.len() as f64;
    let freedom = count - solution.leverages.iter().sum::<f64>();
    if freedom <= 1e-3 * count {
        return f64::INFINITY;
    }
    let errors = residuals(basis, means, &solution.coefficients);
    count * errors.iter().map(|e| e * e).sum::<f64>() / (freedom * freedom)
}
