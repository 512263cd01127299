use volcomp_curve::{CurveError, Table};

use crate::fit::rms;
use crate::{Fit, FitError, readings};

/// A table of the mean reading of each target, with straight lines between.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, fewer than two different targets.
pub fn fit_linear_table(x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
    fit_table(x, u, Table::linear)
}

/// A table of the mean reading of each target, with monotone cubics between.
///
/// # Errors
/// Unequal lengths, numbers that are not finite, fewer than two different targets.
pub fn fit_cubic_table(x: &[f64], u: &[f64]) -> Result<Fit, FitError> {
    fit_table(x, u, Table::cubic)
}

fn fit_table(
    x: &[f64],
    u: &[f64],
    build: fn(Vec<[f64; 2]>) -> Result<Table, CurveError>,
) -> Result<Fit, FitError> {
    let targets = readings::checked_targets(x, u, 2, "a table")?;
    let mut errors = Vec::with_capacity(targets.len());
    for left_out in 1..targets.len() - 1 {
        let mut others = targets.clone();
        let [x, u] = others.remove(left_out);
        errors.push(u - build(others)?.value(x));
    }
    let loo = if errors.is_empty() {
        f64::INFINITY
    } else {
        rms(errors.into_iter())
    };
    Ok(Fit::new(build(targets)?.into(), x, u, loo))
}
