use crate::FitError;

pub(crate) fn check(x: &[f64], u: &[f64]) -> Result<(), FitError> {
    if x.len() != u.len() {
        return Err(FitError::Lengths { abscissae: x.len(), readings: u.len() });
    }
    for (what, numbers) in [("abscissa", x), ("reading", u)] {
        if let Some(index) = numbers.iter().position(|v| !v.is_finite()) {
            return Err(FitError::NotFinite { what, index, value: numbers[index] });
        }
    }
    Ok(())
}

pub(crate) fn check_required(residual: Option<f64>) -> Result<(), FitError> {
    match residual.filter(|r| !(*r > 0.0 && r.is_finite())) {
        Some(value) => Err(FitError::Parameter {
            what: "required residual",
            value,
            expected: "a positive finite number",
        }),
        None => Ok(()),
    }
}

pub(crate) fn check_domain(x: &[f64], [lower, upper]: [f64; 2]) -> Result<(), FitError> {
    match x.iter().position(|v| !(lower..=upper).contains(v)) {
        Some(index) => Err(FitError::OutsideDomain { index, value: x[index], lower, upper }),
        None => Ok(()),
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) struct Target {
    pub(crate) x: f64,
    pub(crate) mean: f64,
    pub(crate) count: f64,
    /// Sum of squared deviations of the readings from their mean.
    pub(crate) squares: f64,
}

pub(crate) fn counted(x: &[f64], u: &[f64]) -> Vec<Target> {
    let mut pairs: Vec<[f64; 2]> = x.iter().zip(u).map(|(&x, &u)| [x, u]).collect();
    pairs.sort_by(|a, b| a[0].total_cmp(&b[0]));
    pairs
        .chunk_by(|a, b| a[0] == b[0])
        .map(|runs| {
            let count = runs.len() as f64;
            let mean = runs.iter().map(|r| r[1]).sum::<f64>() / count;
            Target {
                x: runs[0][0],
                mean,
                count,
                squares: runs.iter().map(|r| (r[1] - mean).powi(2)).sum(),
            }
        })
        .collect()
}

/// Mean reading of each target, by ascending target.
pub(crate) fn targets(x: &[f64], u: &[f64]) -> Vec<[f64; 2]> {
    counted(x, u).iter().map(|t| [t.x, t.mean]).collect()
}

/// Checks the readings and returns the mean of each target. `purpose` names the curve, which needs at least `needed`
/// targets.
pub(crate) fn checked_targets(
    x: &[f64],
    u: &[f64],
    needed: usize,
    purpose: &'static str,
) -> Result<Vec<[f64; 2]>, FitError> {
    check(x, u)?;
    let targets = targets(x, u);
    require(&targets, needed, purpose)?;
    Ok(targets)
}

pub(crate) fn require(
    targets: &[[f64; 2]],
    needed: usize,
    purpose: &'static str,
) -> Result<(), FitError> {
    let found = targets.len();
    if found < needed { Err(FitError::TooFewTargets { purpose, found, needed }) } else { Ok(()) }
}

/// Largest magnitude of the readings. Differences below 1e-9 of it count as rounding.
pub(crate) fn magnitude(u: impl IntoIterator<Item = f64>) -> f64 {
    u.into_iter().fold(0.0, |largest: f64, u| largest.max(u.abs()))
}
