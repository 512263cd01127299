//! Drift terms from temperatures and a displacement over time.
//!
//! The terms are found by ridge regression on first-order lags of temperature differences. Lags, sensors and penalty
//! are chosen by forward validation in time.
//!
//! Neighbouring rows are nearly equal, so a random split would be no test. Each block of time is predicted from earlier
//! blocks only.

use std::ops::Range;

use crate::FitError;

mod columns;
mod judged;
mod record;
mod search;

pub use columns::ThermalEffect;
pub use judged::{
    CoarseRows, JudgedThermal, ThermalPrediction, ThermalVerdict, judge_thermal_rows,
    judge_thermal_runs,
};
pub use record::{ThermalGap, ThermalOptions, ThermalRecord, ThermalRun};
pub use search::{
    TestedRange, ThermalChoice, ThermalFit, ThermalNumber, ThermalSearch, ThermalSegment,
    ThermalSize, ThermalTerm, ThermalTerms, left_out_runs, search_thermal, search_thermal_rows,
};

use columns::{Features, ridge};
use record::enough_rows;
use search::{BLOCKS, best_choices};

/// Fits the rows `train` of a record. Lags, penalty and sensors are chosen by forward validation among these rows.
///
/// # Errors
/// Columns of different lengths, numbers that are not finite, times that do not increase, fewer than 20 rows for each
/// block, or no sensor that changes.
pub fn fit_thermal(
    record: &ThermalRecord,
    train: Range<usize>,
    options: &ThermalOptions,
) -> Result<ThermalFit, FitError> {
    let train = checked(record, &train, options)?;
    let features = Features::new(record, &options.lags_s);
    let choices = best_choices(&features, record, &train, options)?;
    fit_choices(record, &features, &train, options, choices)
}

/// The rows of `train` that no gap in the log excludes.
fn checked(
    record: &ThermalRecord,
    train: &Range<usize>,
    options: &ThermalOptions,
) -> Result<Vec<usize>, FitError> {
    record.check()?;
    options.check()?;
    let known = record.known_rows(train, &options.lags_s);
    enough_rows(record, train, &known, 20 * BLOCKS)?;
    Ok(known)
}

fn fit_choices(
    record: &ThermalRecord,
    features: &Features,
    train: &[usize],
    options: &ThermalOptions,
    choices: Vec<ThermalChoice>,
) -> Result<ThermalFit, FitError> {
    let moments = features.moments(record, train, 1);
    let mut per_k = vec![vec![0.0; features.sensors]; features.lags];
    let mut constant = 0.0;
    let share = 1.0 / choices.len() as f64;
    for choice in &choices {
        let undetermined =
            FitError::Undetermined { coefficients: choice.lags.len() * choice.sensors.len() };
        let found =
            ridge(&moments, &choice.columns(features), choice.penalty).ok_or(undetermined)?;
        constant += share * found.constant;
        let places = choice
            .lags
            .iter()
            .flat_map(|lag| choice.sensors.iter().map(move |sensor| (*lag, *sensor)));
        for ((lag, sensor), weight) in places.zip(&found.weights) {
            per_k[lag][sensor] += share * weight;
        }
    }
    let terms =
        options.lags_s.iter().zip(per_k).map(|(&lag_s, per_k)| ThermalTerm { lag_s, per_k });
    Ok(ThermalFit {
        terms: terms.filter(|term| term.per_k.iter().any(|k| *k != 0.0)).collect(),
        constant,
        start_degc: features.start_degc.clone(),
        forward_rms: choices.first().map_or(f64::INFINITY, |choice| choice.forward_rms),
        choices,
    })
}
