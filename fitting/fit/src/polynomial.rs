//! Fits of polynomials and Fourier series, and tables of mean readings.

use std::f64::consts::TAU;

use nalgebra::DMatrix;
use volcomp_curve::{Chebyshev, CurveError, Fourier, Polynomial, Table};

use crate::fit::{Nested, Solution};
use crate::readings::{self, Target};
use crate::{Fit, FitError};

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
    let nested = nested_chebyshev(&readings::counted(x, u), order, domain);
    let coefficients = order + 1;
    let solution = nested.solution(coefficients).ok_or(FitError::Undetermined { coefficients })?;
    Ok((Chebyshev::new(solution.coefficients.clone(), domain)?, solution))
}

const PURPOSE: &str = "a polynomial of this order";

/// Least-squares solutions of the Chebyshev series of all orders up to `order`.
pub(crate) fn nested_chebyshev(targets: &[Target], order: usize, domain: [f64; 2]) -> Nested {
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
    let nested = nested_fourier(&readings::counted(x, u), order, period);
    let solution = nested.solution(coefficients).ok_or(FitError::Undetermined { coefficients })?;
    let curve = Fourier::new(solution.coefficients.clone(), period, domain)?;
    Ok(Fit::least_squares(curve.into(), x, u, &solution))
}

pub(crate) fn nested_fourier(targets: &[Target], order: usize, period: f64) -> Nested {
    let matrix = DMatrix::from_fn(targets.len(), 2 * order + 1, |i, k| {
        let angle = TAU * (targets[i].x / period) * k.div_ceil(2) as f64;
        if k % 2 == 0 && k > 0 { angle.sin() } else { angle.cos() }
    });
    Nested::new(matrix, targets)
}

/// Fits a table of the mean reading of each target, with straight lines between the targets.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, or fewer than two different targets.
pub fn fit_linear_table(x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
    fit_table(x, u, Table::linear)
}

/// Fits a table of the mean reading of each target, with monotone cubics between the targets.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, or fewer than two different targets.
pub fn fit_cubic_table(x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
    fit_table(x, u, Table::cubic)
}

fn fit_table(
    x: &[f64],
    u: &[f64],
    build: fn(Vec<[f64; 2]>) -> Result<Table, CurveError>,
) -> Result<Fit, FitError> {
    let targets = readings::checked_targets(x, u, 2, "a table")?;
    let errors = left_out(&targets, build)?;
    // The first target is not left out, so the errors start at index 1.
    let missed = errors.into_iter().enumerate();
    let missed = missed.map(|(place, error)| (place + 1, error));
    Ok(Fit::new(build(targets)?.into(), x, u, missed))
}

/// Leave-one-out errors of the inner targets. Slopes depend on at most two targets on each side, so only a piece of the
/// table is rebuilt.
pub(crate) fn left_out(
    targets: &[[f64; 2]],
    build: fn(Vec<[f64; 2]>) -> Result<Table, CurveError>,
) -> Result<Vec<f64>, FitError> {
    let inner = 1..targets.len().saturating_sub(1);
    let miss = |i: usize| {
        let mut others =
            targets[i.saturating_sub(REACH)..targets.len().min(i + REACH + 1)].to_vec();
        let [x, u] = others.remove(i.min(REACH));
        Ok(u - build(others)?.value(x))
    };
    inner.map(miss).collect()
}

const REACH: usize = 3;
