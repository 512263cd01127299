use std::f64::consts::TAU;

use nalgebra::DMatrix;
use volcomp_curve::Fourier;

use crate::{Fit, FitError, least_squares, readings};

/// Fits a Fourier series with `order` harmonics of the period by least squares.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, a period that is not positive, targets outside the
/// domain, or targets whose phases do not determine the `2 order + 1` coefficients.
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
    readings::require(
        &readings::targets(x, u),
        coefficients,
        "this many harmonics",
    )?;
    let matrix = DMatrix::from_fn(x.len(), coefficients, |i, k| {
        let angle = TAU * (x[i] / period) * k.div_ceil(2) as f64;
        if k % 2 == 0 && k > 0 {
            angle.sin()
        } else {
            angle.cos()
        }
    });
    let solution =
        least_squares::solve(matrix, u).ok_or(FitError::Undetermined { coefficients })?;
    let curve = Fourier::new(solution.coefficients, period, domain)?;
    Ok(Fit::least_squares(curve.into(), x, u, &solution.leverages))
}
