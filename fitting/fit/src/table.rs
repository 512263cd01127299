use volcomp_curve::{CurveError, Table};

use crate::{Fit, FitError, readings};

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
