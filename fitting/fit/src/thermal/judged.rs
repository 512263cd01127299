//! Assesses thermal terms by their errors in parts of the tests that were not used to find the terms.

use std::ops::Range;

use super::fit_thermal;
use super::record::{ThermalOptions, ThermalRun};
use super::search::{
    ThermalSearch, ThermalSegment, ThermalTerms, left_out_runs, search_thermal, search_thermal_rows,
};
use crate::{FitError, fit::rms};

/// Number of stretches into which the predicted rows of a single run are divided.
const STRETCHES: usize = 10;
/// Relative change of a root mean square error below which the change is insignificant.
const NO_DIFFERENCE: f64 = 0.1;

/// Error of terms, in the unit of the displacement, when predicting rows that were not used to find them.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ThermalPrediction {
    /// Root mean square error of the prediction. For terms with few coefficients it includes the
    /// possible effect of temperature changes between rows.
    pub rms: f64,
    /// The stretch with the largest error, of ten with equal numbers of rows; only for a single
    /// run.
    #[cfg_attr(feature = "serde", serde(rename = "worst_segment"))]
    pub worst: Option<ThermalSegment>,
    /// Mean square error in each part: a run, or a stretch of the predicted rows. NaN if a gap
    /// excludes all rows.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub parts: Vec<f64>,
    /// Root mean square error of the forward validation, by which penalty, time constants and
    /// sensors were chosen.
    pub forward_rms: f64,
    /// Ridge penalties of the models that are averaged.
    pub penalties: Vec<f64>,
    /// Time constants of the drift terms, s.
    pub lags_s: Vec<f64>,
    /// Indices of the sensors with a nonzero weight.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub sensors: Vec<usize>,
}

/// Thermal terms of a displacement. Their prediction errors are those of terms that were found in the same way from a
/// part of the data.
#[derive(Clone, Debug, PartialEq)]
pub struct JudgedThermal {
    /// Prediction by a regression without time constants.
    pub plain: ThermalPrediction,
    /// Prediction by a regression on every sensor, averaged over many choices of time constants; only for a single run
    /// without positions.
    pub dense: Option<ThermalPrediction>,
    /// Prediction by sparse terms with time constants.
    pub few: ThermalPrediction,
    /// Root mean square of the displacement in the predicted rows, µm or µrad. This is the error without terms.
    pub none_rms: f64,
    /// Mean square of the displacement in each part, µm² or µrad².
    pub none_of_parts: Vec<f64>,
    /// The assessed sparse terms, which were found from all runs and rows.
    pub terms: ThermalTerms,
    /// Root mean square error in each run, µm or µrad, by terms that were found from the other runs; empty for a single
    /// run.
    pub left_out: Vec<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ThermalVerdict {
    /// The terms predict better than no terms, and no worse than a regression without time constants.
    Good,
    /// The terms predict no better than no terms.
    NoBetterThanNone,
    /// The terms predict worse than a regression without time constants.
    WorseThanPlain,
}

/// Warning that the rows are too far apart for the time constants of the terms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoarseRows {
    /// Index of the run in which the distance of the rows has the largest effect.
    pub run: usize,
    /// Median interval between rows, s.
    pub interval_s: f64,
    /// Shortest non-zero time constant of the terms, s.
    pub shortest_lag_s: f64,
    /// Root mean square increase of the prediction error due to unknown temperatures between the rows, µm or µrad.
    pub adds_rms: f64,
    /// Interval between rows at which this increase would be insignificant, s.
    pub enough_s: f64,
}

/// Assesses terms from a single run. Terms that are found from its first `train` rows predict the other rows.
///
/// # Errors
/// The errors of [`search_thermal`] and [`fit_thermal`].
pub fn judge_thermal_rows(
    run: &ThermalRun,
    train: usize,
    search: &ThermalSearch,
) -> Result<JudgedThermal, FitError> {
    let rows = run.record.len();
    let by_time = |search: &ThermalSearch| {
        let terms = search_thermal_rows(run, 0..train, search)?;
        Ok::<_, FitError>(ThermalPrediction::by_time(&terms, run, train))
    };
    // The regressions on one record do not support several positions of the axis.
    let regression = |options: ThermalOptions| {
        let fit = fit_thermal(&run.record, 0..train, &options)?;
        let (rms, worst) = fit.residual(&run.record, train..rows);
        Ok::<_, FitError>(ThermalPrediction {
            rms,
            worst,
            parts: mean_squares(train..rows, |rows| fit.residual(&run.record, rows).0),
            forward_rms: fit.forward_rms,
            penalties: fit.choices.iter().map(|choice| choice.penalty).collect(),
            lags_s: fit.terms.iter().map(|term| term.lag_s).collect(),
            sensors: fit.sensors(),
        })
    };
    let stands = run.position_mm.is_empty();
    let none = |rows: Range<usize>| rms_from_mean(&run.record.displacement, train, rows);
    Ok(JudgedThermal {
        plain: if stands {
            regression(ThermalOptions::plain())?
        } else {
            by_time(&without_lags(search))?
        },
        dense: (stands.then(|| regression(ThermalOptions::default()))).transpose()?,
        few: by_time(search)?,
        none_rms: none(train..rows),
        none_of_parts: mean_squares(train..rows, none),
        terms: search_thermal(std::slice::from_ref(run), search)?,
        left_out: Vec::new(),
    })
}

/// Assesses terms from several runs. Each run is predicted by terms that are found from the other runs.
///
/// # Errors
/// The errors of [`search_thermal`] and [`left_out_runs`].
pub fn judge_thermal_runs(
    runs: &[ThermalRun],
    search: &ThermalSearch,
) -> Result<JudgedThermal, FitError> {
    let terms = search_thermal(runs, search)?;
    let mut left_out = left_out_runs(runs, search)?;
    for (left, run) in left_out.iter_mut().zip(runs) {
        *left = left.hypot(terms.rms_between_rows(run));
    }
    let without_lags = without_lags(search);
    let plain = search_thermal(runs, &without_lags)?;
    let plain_left_out = left_out_runs(runs, &without_lags)?;
    let none: Vec<f64> = runs.iter().map(ThermalRun::rms_from_start).collect();
    Ok(JudgedThermal {
        plain: ThermalPrediction::by_runs(&plain, runs, &plain_left_out),
        dense: None,
        few: ThermalPrediction::by_runs(&terms, runs, &left_out),
        none_rms: mean_of_runs(runs, &none),
        none_of_parts: none.iter().map(|rms| rms * rms).collect(),
        terms,
        left_out,
    })
}

impl JudgedThermal {
    /// Compares the prediction errors. A difference counts if it exceeds both its standard error over the parts and a
    /// tenth of the error.
    pub fn verdict(&self) -> ThermalVerdict {
        verdict(&self.few.parts, &self.plain.parts, &self.none_of_parts)
    }

    /// Mean square error without terms minus the mean square error with terms, and the standard error of this
    /// difference over the parts.
    pub fn gain(&self) -> (f64, f64) {
        difference(&self.none_of_parts, &self.few.parts)
    }

    /// Mean square error with time constants minus the mean square error without time constants, and the standard error
    /// of this difference over the parts.
    pub fn loss(&self) -> (f64, f64) {
        difference(&self.few.parts, &self.plain.parts)
    }

    /// Warning if the rows are so far apart that the unknown temperatures between them increase the prediction error by
    /// more than a tenth; else `None`.
    pub fn coarse_rows(&self, runs: &[ThermalRun]) -> Option<CoarseRows> {
        let lags = self.terms.lags_s();
        let shortest_lag_s = lags.into_iter().find(|lag| *lag > 0.0)?;
        let of = |run: &ThermalRun| self.terms.rms_between_rows(run);
        let adds_rms = rms(runs.iter().map(of));
        // Root mean square error in the rows, without the increase between rows.
        let rows = (self.few.rms.powi(2) - adds_rms.powi(2)).max(0.0).sqrt();
        let unseen = ((1.0 + NO_DIFFERENCE).powi(2) - 1.0).sqrt() * rows;
        if adds_rms <= unseen {
            return None;
        }
        let runs = runs.iter().enumerate();
        let (run, largest) = runs.max_by(|a, b| of(a.1).total_cmp(&of(b.1)))?;
        let interval_s = largest.record.usual_interval_s();
        Some(CoarseRows {
            run,
            interval_s,
            shortest_lag_s,
            adds_rms,
            // The departure of a temperature from a straight line grows with the square of the interval.
            enough_s: rounded_down(interval_s * (unseen / adds_rms).sqrt()),
        })
    }
}

impl ThermalPrediction {
    fn new(terms: &ThermalTerms, rms: f64, worst: Option<ThermalSegment>, parts: Vec<f64>) -> Self {
        let squares: f64 = terms.validated.iter().map(|rms| rms * rms).sum();
        Self {
            rms,
            worst,
            parts,
            forward_rms: (squares / terms.validated.len().max(1) as f64).sqrt(),
            penalties: vec![terms.penalty],
            lags_s: terms.lags_s(),
            sensors: terms.sensors(),
        }
    }

    /// Errors of terms in the rows from `train` on, including the errors due to unknown temperatures between rows.
    fn by_time(terms: &ThermalTerms, run: &ThermalRun, train: usize) -> Self {
        let between = terms.rms_between_rows(run);
        let left = |rows: Range<usize>| {
            let (rms, worst) = terms.residual(run, rows);
            (rms.hypot(between), worst)
        };
        let (rms, mut worst) = left(train..run.record.len());
        if let Some(worst) = &mut worst {
            worst.rms = worst.rms.hypot(between);
        }
        let parts = mean_squares(train..run.record.len(), |rows| left(rows).0);
        Self::new(terms, rms, worst, parts)
    }

    fn by_runs(terms: &ThermalTerms, runs: &[ThermalRun], left_out: &[f64]) -> Self {
        let parts = left_out.iter().map(|rms| rms * rms).collect();
        Self::new(terms, mean_of_runs(runs, left_out), None, parts)
    }
}

fn without_lags(search: &ThermalSearch) -> ThermalSearch {
    ThermalSearch { lags_s: vec![0.0], ..search.clone() }
}

/// Root mean square over all rows, from the root mean square of each run.
fn mean_of_runs(runs: &[ThermalRun], rms: &[f64]) -> f64 {
    let rows = runs.iter().map(|run| run.record.len() as f64);
    let squares = rms.iter().zip(rows.clone()).map(|(rms, n)| rms * rms * n);
    (squares.sum::<f64>() / rows.sum::<f64>().max(1.0)).sqrt()
}

/// Mean square in each of `STRETCHES` equal stretches of rows; NaN for a stretch whose rows are all excluded by a gap.
fn mean_squares(rows: Range<usize>, rms: impl Fn(Range<usize>) -> f64) -> Vec<f64> {
    let at = |part: usize| rows.start + rows.len() * part / STRETCHES;
    let of = |part: usize| rms(at(part)..at(part + 1)).powi(2);
    (0..STRETCHES).filter(|part| at(*part) < at(part + 1)).map(of).collect()
}

/// Root mean square deviation of `rows` from the mean of the rows before `train`.
fn rms_from_mean(of: &[f64], train: usize, rows: Range<usize>) -> f64 {
    let before = of.get(..train).unwrap_or_default();
    let mean = before.iter().sum::<f64>() / before.len() as f64;
    let rows = of.get(rows).unwrap_or_default();
    rms(rows.iter().map(|d| d - mean))
}

/// Mean and standard error of the differences of two lists, part by part. A part that is NaN in either list, because a
/// gap excludes all its rows, is skipped. If no part remains, both results are NaN.
fn difference(these: &[f64], those: &[f64]) -> (f64, f64) {
    let of = these.iter().zip(those).map(|(a, b)| a - b);
    let of: Vec<f64> = of.filter(|difference| !difference.is_nan()).collect();
    let count = of.len() as f64;
    if of.is_empty() && !these.is_empty() {
        return (f64::NAN, f64::NAN);
    }
    let mean = of.iter().sum::<f64>() / count.max(1.0);
    let squares: f64 = of.iter().map(|d| (d - mean).powi(2)).sum();
    (mean, (squares / (count - 1.0).max(1.0) / count.max(1.0)).sqrt())
}

/// Largest difference of mean squares that is insignificant relative to these mean squares.
fn unseen(squares: &[f64]) -> f64 {
    let known = || squares.iter().filter(|square| !square.is_nan());
    let mean = known().sum::<f64>() / known().count().max(1) as f64;
    ((1.0 + NO_DIFFERENCE).powi(2) - 1.0) * mean
}

fn verdict(few: &[f64], plain: &[f64], none: &[f64]) -> ThermalVerdict {
    let (gain, scatter) = difference(none, few);
    // NaN means that there is nothing to compare, or that a value is undefined.
    if gain.is_nan() || gain <= scatter.max(unseen(none)) {
        return ThermalVerdict::NoBetterThanNone;
    }
    let (loss, scatter) = difference(few, plain);
    if loss > scatter.max(unseen(plain)) {
        return ThermalVerdict::WorseThanPlain;
    }
    ThermalVerdict::Good
}

/// Largest number in the series 1, 2, 5, 10, 20, … s that does not exceed `seconds`; at least 1.
fn rounded_down(seconds: f64) -> f64 {
    let ten = 10_f64.powf(seconds.max(1.0).log10().floor());
    let steps = [5.0, 2.0].into_iter().map(|step| step * ten);
    steps.into_iter().find(|step| *step <= seconds).unwrap_or(ten)
}

#[cfg(test)]
mod tests {
    use super::{ThermalVerdict as Verdict, verdict};

    #[test]
    fn indistinguishable_results_are_no_reason() {
        let none = [900.0, 800.0, 950.0, 1000.0];
        let plain = [0.048, 0.05, 0.047, 0.049];
        for (few, expected) in [
            // The RMS error is 0.23 with the terms and 0.22 without time constants.
            (&[0.052, 0.055, 0.05, 0.053][..], Verdict::Good),
            (&[0.1; 4], Verdict::WorseThanPlain),
            // The terms are worse in only one of four parts.
            (&[0.04, 0.04, 0.04, 0.1], Verdict::Good),
            (&none, Verdict::NoBetterThanNone),
            (&[f64::NAN; 4], Verdict::NoBetterThanNone),
            // A gap excludes all rows of one stretch.
            (&[0.052, f64::NAN, 0.05, 0.053], Verdict::Good),
        ] {
            assert_eq!(verdict(few, &plain, &none), expected, "{few:?}");
        }
        assert_eq!(verdict(&[], &[], &[]), Verdict::NoBetterThanNone);
    }
}
