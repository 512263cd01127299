use nalgebra::DMatrix;
use volcomp_curve::{Chebyshev, Polynomial};

use crate::least_squares::{Nested, Solution};
use crate::readings::Target;
use crate::{Fit, FitError, readings};

/// Fits a Chebyshev series of this order on `domain` by least squares (Householder QR).
///
/// # Errors
/// Unequal lengths, numbers that are not finite, targets outside the domain, fewer than `order + 1` different targets,
/// or an empty domain.
pub fn fit_chebyshev(
    x: &[f64],
    u: &[f64],
    order: usize,
    domain: [f64; 2],
) -> Result<Fit, FitError> {
    let (series, solution) = series(x, u, order, domain)?;
    Ok(Fit::least_squares(series.into(), x, u, &solution))
}

/// Fits a polynomial of this order by least squares like [`fit_chebyshev`], and converts it to powers of the argument.
///
/// # Errors
/// The errors of [`fit_chebyshev`], and a domain so far from 0 that powers of the argument would lose more than 1e-7 of
/// the readings.
pub fn fit_polynomial(
    x: &[f64],
    u: &[f64],
    order: usize,
    domain: [f64; 2],
) -> Result<Fit, FitError> {
    let (series, solution) = series(x, u, order, domain)?;
    let polynomial = in_powers(&series, readings::magnitude(u.iter().copied()))?;
    Ok(Fit::least_squares(polynomial.into(), x, u, &solution))
}

/// Converts a Chebyshev series to powers of the argument.
///
/// # Errors
/// The two forms differ by more than 1e-7 · `magnitude`, the magnitude of the readings.
pub(crate) fn in_powers(series: &Chebyshev, magnitude: f64) -> Result<Polynomial, FitError> {
    let order = series.coefficients().len() - 1;
    let [lower, upper] = series.domain();
    let polynomial = Polynomial::new(powers(series), series.domain())?;
    let probes = (0..=8 * (order + 1)).map(|i| {
        let s = i as f64 / (8 * (order + 1)) as f64;
        lower + s * (upper - lower)
    });
    let error = readings::magnitude(probes.map(|x| polynomial.value(x) - series.value(x)));
    if error > 1e-7 * magnitude {
        return Err(FitError::PowersLoseDigits { order, lower, upper, error });
    }
    Ok(polynomial)
}

fn series(
    x: &[f64],
    u: &[f64],
    order: usize,
    domain: [f64; 2],
) -> Result<(Chebyshev, Solution), FitError> {
    readings::check(x, u)?;
    // Report an empty domain before the readings are checked against it.
    Chebyshev::new(vec![0.0], domain)?;
    readings::check_domain(x, domain)?;
    let needed = order.saturating_add(1);
    readings::require(&readings::targets(x, u), needed, PURPOSE)?;
    let nested = nested(&readings::counted(x, u), order, domain);
    let coefficients = order + 1;
    let solution = nested.solution(coefficients).ok_or(FitError::Undetermined { coefficients })?;
    Ok((Chebyshev::new(solution.coefficients.clone(), domain)?, solution))
}

const PURPOSE: &str = "a polynomial of this order";

/// Least-squares solutions of the Chebyshev series of all orders up to `order`.
pub(crate) fn nested(targets: &[Target], order: usize, domain: [f64; 2]) -> Nested {
    Nested::new(chebyshev_matrix(targets, order, domain), targets)
}

fn chebyshev_matrix(targets: &[Target], order: usize, [lower, upper]: [f64; 2]) -> DMatrix<f64> {
    let mut matrix = DMatrix::from_element(targets.len(), order + 1, 1.0);
    for (i, Target { x, .. }) in targets.iter().enumerate() {
        let t = ((x - lower) - (upper - x)) / (upper - lower);
        for k in 1..=order {
            matrix[(i, k)] =
                if k == 1 { t } else { 2.0 * t * matrix[(i, k - 1)] - matrix[(i, k - 2)] };
        }
    }
    matrix
}

/// Coefficients of a Chebyshev series in powers of x, by Clenshaw's recurrence applied to polynomials, with `t =
/// shift + rate x`.
fn powers(series: &Chebyshev) -> Vec<f64> {
    let [lower, upper] = series.domain();
    let (shift, rate) = (-(lower + upper) / (upper - lower), 2.0 / (upper - lower));
    let coefficients = series.coefficients();
    let size = coefficients.len();
    let (mut b1, mut b2) = (vec![0.0; size], vec![0.0; size]);
    for k in (0..size).rev() {
        let twice = if k == 0 { 1.0 } else { 2.0 };
        let next = (0..size).map(|i| {
            let raised = if i == 0 { 0.0 } else { rate * b1[i - 1] };
            let constant = if i == 0 { coefficients[k] } else { 0.0 };
            constant + twice * (shift * b1[i] + raised) - b2[i]
        });
        (b1, b2) = (next.collect(), b1);
    }
    b1
}
