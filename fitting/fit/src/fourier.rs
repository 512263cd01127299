use std::f64::consts::TAU;

use nalgebra::DMatrix;
use volcomp_curve::Fourier;

use crate::least_squares::Nested;
use crate::readings::Target;
use crate::{Fit, FitError, readings};

/// Fits a Fourier series with `order` harmonics of the period by least squares.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, a period that is not positive, targets outside the domain, or targets
/// whose phases do not determine the `2 order + 1` coefficients.
pub fn fit_fourier(
    x: &[f64],
    u: &[f64],
    order: usize,
    period: f64,
    domain: [f64; 2],
) -> Result<Fit, FitError> {
    readings::check(x, u)?;
    Fourier::new(vec![0.0], period, domain)?;
    readings::check_domain(x, domain)?;
    let coefficients = order.saturating_mul(2).saturating_add(1);
    readings::require(&readings::targets(x, u), coefficients, "this many harmonics")?;
    let nested = nested(&readings::counted(x, u), order, period);
    let solution = nested.solution(coefficients).ok_or(FitError::Undetermined { coefficients })?;
    let curve = Fourier::new(solution.coefficients.clone(), period, domain)?;
    Ok(Fit::least_squares(curve.into(), x, u, &solution))
}

pub(crate) fn nested(targets: &[Target], order: usize, period: f64) -> Nested {
    let matrix = DMatrix::from_fn(targets.len(), 2 * order + 1, |i, k| {
        let angle = TAU * (targets[i].x / period) * k.div_ceil(2) as f64;
        if k % 2 == 0 && k > 0 { angle.sin() } else { angle.cos() }
    });
    Nested::new(matrix, targets)
}
