//! Readings at targets: their checks, their scatter, and tests against this scatter.
//!
//! Student quantiles take small numbers of runs into account.

use crate::{FitError, readings};

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

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Noise {
    /// Standard deviation of a reading.
    pub deviation: f64,
    /// Degrees of freedom of the estimate; infinite if the deviation is known.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub freedom: f64,
}

impl Noise {
    /// Pooled standard deviation of repeated readings; `None` if no target has several readings, or if repeated
    /// readings do not differ.
    pub(crate) fn pooled(targets: &[readings::Target]) -> Option<Self> {
        let squares: f64 = targets.iter().map(|t| t.squares).sum();
        let freedom: f64 = targets.iter().map(|t| t.count - 1.0).sum();
        let deviation = (squares / freedom).sqrt();
        (deviation > 0.0 && deviation.is_finite()).then_some(Self { deviation, freedom })
    }

    /// Whether this noise explains a sum of squared residuals with these degrees of freedom. Each residual is weighted
    /// by its number of readings. The test is at the 1 % level and uses that the cube root of F is nearly normal (E.
    /// Paulson, Ann. Math. Stat. 13, 1942).
    pub(crate) fn explains(&self, squares: f64, freedom: f64) -> bool {
        if freedom < MIN_FREEDOM {
            return true;
        }
        let root = (squares / freedom / self.deviation.powi(2)).cbrt();
        let (above, below) = (2.0 / (9.0 * freedom), 2.0 / (9.0 * self.freedom));
        let score = ((1.0 - below) * root - (1.0 - above)) / (below * root * root + above).sqrt();
        score <= ONE_IN_A_HUNDRED
    }
}

/// 99 % quantile of the standard normal distribution.
const ONE_IN_A_HUNDRED: f64 = 2.326_348;
/// Minimum degrees of freedom of the test. With fewer the curve interpolates the readings.
const MIN_FREEDOM: f64 = 0.5;

/// Half width of the 95 % band of a normal distribution, in standard deviations.
const NORMAL_95: f64 = 1.959_964;

/// Degrees of freedom and two-sided Student t for 95 % (JCGM 100, table G.2, with more digits).
const TABLE: [(f64, f64); 22] = [
    (1.0, 12.706_205),
    (1.12, 9.900_444),
    (1.25, 8.027_952),
    (1.375, 6.845_719),
    (1.5, 6.016_663),
    (1.75, 4.948_848),
    (2.0, 4.302_653),
    (2.25, 3.875_480),
    (2.5, 3.574_655),
    (3.0, 3.182_446),
    (3.5, 2.940_089),
    (4.0, 2.776_445),
    (5.0, 2.570_582),
    (6.0, 2.446_912),
    (8.0, 2.306_004),
    (10.0, 2.228_139),
    (15.0, 2.131_450),
    (20.0, 2.085_963),
    (30.0, 2.042_272),
    (60.0, 2.000_298),
    (120.0, 1.979_930),
    (f64::INFINITY, NORMAL_95),
];

/// Two-sided Student t for 95 %. Its logarithm is interpolated over 1/ν in the table. Below one degree of freedom the
/// value for one is returned.
pub(crate) fn student_95(degrees: f64) -> f64 {
    let at = 1.0 / degrees.max(1.0);
    let mut wide = TABLE[0];
    for narrow in TABLE {
        let (from, to) = (1.0 / wide.0, 1.0 / narrow.0);
        if at >= to {
            let share = if from > to { (at - to) / (from - to) } else { 1.0 };
            return (narrow.1.ln() + share * (wide.1.ln() - narrow.1.ln())).exp();
        }
        wide = narrow;
    }
    NORMAL_95
}

/// Factor that widens a standard uncertainty with these degrees of freedom, so that ±1.96 times the result is the 95 %
/// band (JCGM 100, G.3).
pub fn student_widening(degrees: f64) -> f64 {
    student_95(degrees) / NORMAL_95
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Probability beyond ±t, integrated by Simpson's rule over an angle θ with t = √ν tan θ and the density cos^(ν−1)
    /// θ.
    fn beyond(t: f64, degrees: f64) -> f64 {
        const STEPS: usize = 10_000;
        let end = core::f64::consts::FRAC_PI_2;
        let integral = |from: f64, to: f64| {
            let width = (to - from) / STEPS as f64;
            let at = |k: usize| {
                let density = (from + width * k as f64).cos().max(0.0).powf(degrees - 1.0);
                let weight = match k {
                    0 | STEPS => 1.0,
                    _ if k % 2 == 1 => 4.0,
                    _ => 2.0,
                };
                weight * density
            };
            (0..=STEPS).map(at).sum::<f64>() * width / 3.0
        };
        let from = (t / degrees.sqrt()).atan();
        integral(from, end) / integral(0.0, end)
    }

    #[test]
    fn five_percent_lie_beyond() {
        let low = (0..=60).map(|step| 1.0 + 0.05 * f64::from(step));
        let high = [4.5, 5.5, 7.0, 9.0, 12.0, 17.0, 25.0, 45.0, 60.0, 90.0, 200.0, 500.0];
        for degrees in low.chain(high) {
            let found = beyond(student_95(degrees), degrees);
            assert!((found - 0.05).abs() < 1.2e-4, "{degrees}: {found}");
        }
        assert_eq!(student_95(0.3), student_95(1.0));
        assert!((student_95(f64::INFINITY) - NORMAL_95).abs() < 1e-12);
        assert!((student_95(1.0) - (0.475 * core::f64::consts::PI).tan()).abs() < 1e-6);
    }
}
