//! From temperatures and a displacement over time to drift terms: ridge regression on first-order lags of
//! temperature differences, everything chosen by forward validation in time.
//!
//! Rows next to one another are nearly equal, so a random split would tell nothing: each block of
//! time is predicted from what was before it, never from what came after.

use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DVector};

use crate::{FitError, fit::rms};

/// Rows that choose lags and penalty, at the most: more say the same again.
const ROWS_TO_CHOOSE: usize = 2000;
/// Blocks of time for the forward validation; the first two only teach.
const BLOCKS: usize = 10;
/// A choice this much worse than the best is not in the mean.
const MEAN_WITHIN: f64 = 1.25;
/// Columns of the moments before the features: 1 and the displacement.
const BEFORE: usize = 2;

/// A thermal test: temperatures and one displacement over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThermalRecord {
    /// Time of each row, s, increasing.
    pub time_s: Vec<f64>,
    /// degC of each sensor in each row: `degc[sensor][row]`.
    pub degc: Vec<Vec<f64>>,
    /// The displacement in each row, um or urad.
    pub displacement: Vec<f64>,
}

/// What may be chosen from.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermalOptions {
    /// Time constants, s; 0: no lag. Each alone and each pair is tried.
    pub lags_s: Vec<f64>,
    /// Penalties of the ridge regression, as shares of the variance of a feature.
    pub penalties: Vec<f64>,
    /// Leave out sensors as long as the forward validation does not get worse.
    pub select_sensors: bool,
    /// The mean is taken over so many of the best choices: the very best is so by luck, too.
    pub mean_of: usize,
}

impl Default for ThermalOptions {
    fn default() -> Self {
        Self {
            lags_s: vec![
                0.0, 120.0, 300.0, 600.0, 900.0, 1200.0, 1800.0, 2700.0, 3600.0, 5400.0,
            ],
            penalties: vec![1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1],
            select_sensors: false,
            mean_of: 20,
        }
    }
}

impl ThermalOptions {
    /// Plain ridge regression on temperature differences, its penalty chosen alike: what a fit has to beat.
    pub fn plain() -> Self {
        Self {
            lags_s: vec![0.0],
            mean_of: 1,
            ..Self::default()
        }
    }
}

/// A drift term: the lag of Σ um_per_k·(T − start).
#[derive(Clone, Debug, PartialEq)]
pub struct ThermalTerm {
    /// Time constant, s.
    pub lag_s: f64,
    /// um or urad for each K of each sensor; 0 where it is left out.
    pub per_k: Vec<f64>,
}

/// Drift terms and how they were chosen.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermalFit {
    /// The terms.
    pub terms: Vec<ThermalTerm>,
    /// Displacement with every sensor at its start, um or urad.
    pub constant: f64,
    /// The temperatures that differences count from, degC: those of the first row.
    pub start_degc: Vec<f64>,
    /// Root mean square over the blocks of the forward validation, um or urad, of the best choice.
    pub forward_rms: f64,
    /// The choices that the terms are the mean of.
    pub choices: Vec<ThermalChoice>,
}

/// Lags, sensors and penalty of one regression.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermalChoice {
    /// Places of its time constants in [`ThermalOptions::lags_s`].
    pub lags: Vec<usize>,
    /// The sensors it uses.
    pub sensors: Vec<usize>,
    /// Its penalty.
    pub penalty: f64,
    /// Its forward validation, um or urad.
    pub forward_rms: f64,
}

/// A stretch of time and how far off a fit is in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ThermalSegment {
    /// From, s.
    pub from_s: f64,
    /// To, s.
    pub to_s: f64,
    /// Root mean square, um or urad.
    pub rms: f64,
}

/// Fits the rows `train` of a record: lags, penalty and sensors by forward validation among them.
///
/// # Errors
/// Rows of different lengths, numbers that are not finite, time that does not increase, fewer than 20 rows for each
/// block, no sensor that changes.
pub fn fit_thermal(
    record: &ThermalRecord,
    train: Range<usize>,
    options: &ThermalOptions,
) -> Result<ThermalFit, FitError> {
    check(record, &train, options)?;
    let features = Features::new(record, &options.lags_s);
    let choices = best_choices(&features, record, &train, options)?;
    fit_choices(record, &features, train, options, choices)
}

/// Fits the rows `train` with choices that were made before, on a part of them.
///
/// # Errors
/// As [`fit_thermal`].
pub fn refit_thermal(
    record: &ThermalRecord,
    train: Range<usize>,
    options: &ThermalOptions,
    choices: &[ThermalChoice],
) -> Result<ThermalFit, FitError> {
    check(record, &train, options)?;
    let features = Features::new(record, &options.lags_s);
    fit_choices(record, &features, train, options, choices.to_vec())
}

fn check(
    record: &ThermalRecord,
    train: &Range<usize>,
    options: &ThermalOptions,
) -> Result<(), FitError> {
    record.check()?;
    check_options(options)?;
    if train.end > record.len() || train.len() < 20 * BLOCKS {
        return Err(FitError::TooFewTargets {
            purpose: "a thermal fit",
            found: train.len().min(record.len()),
            needed: 20 * BLOCKS,
        });
    }
    Ok(())
}

/// The mean of the regressions of some choices.
fn fit_choices(
    record: &ThermalRecord,
    features: &Features,
    train: Range<usize>,
    options: &ThermalOptions,
    choices: Vec<ThermalChoice>,
) -> Result<ThermalFit, FitError> {
    let moments = features.moments(record, train, 1);
    let mut per_k = vec![vec![0.0; features.sensors]; features.lags];
    let mut constant = 0.0;
    let share = 1.0 / choices.len() as f64;
    for choice in &choices {
        let undetermined = FitError::Undetermined {
            coefficients: choice.lags.len() * choice.sensors.len(),
        };
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
    let terms = options
        .lags_s
        .iter()
        .zip(per_k)
        .map(|(&lag_s, per_k)| ThermalTerm { lag_s, per_k });
    Ok(ThermalFit {
        terms: terms
            .filter(|term| term.per_k.iter().any(|k| *k != 0.0))
            .collect(),
        constant,
        start_degc: features.start_degc.clone(),
        forward_rms: choices
            .first()
            .map_or(f64::INFINITY, |choice| choice.forward_rms),
        choices,
    })
}

impl ThermalRecord {
    /// Rows.
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    fn check(&self) -> Result<(), FitError> {
        let named = [("time", &self.time_s), ("displacement", &self.displacement)];
        let all = named
            .into_iter()
            .chain(self.degc.iter().map(|column| ("temperature", column)));
        for (what, column) in all {
            if column.len() != self.len() {
                return Err(FitError::Lengths {
                    abscissae: self.len(),
                    readings: column.len(),
                });
            }
            if let Some((index, &value)) = column.iter().enumerate().find(|(_, x)| !x.is_finite()) {
                return Err(FitError::NotFinite { what, index, value });
            }
        }
        match self.time_s.windows(2).find(|pair| pair[1] <= pair[0]) {
            Some(pair) => Err(FitError::Parameter {
                what: "time, s",
                value: pair[1],
                expected: "later than the row before",
            }),
            None => Ok(()),
        }
    }
}

fn check_options(options: &ThermalOptions) -> Result<(), FitError> {
    let wrong = |what, value, expected| {
        Err(FitError::Parameter {
            what,
            value,
            expected,
        })
    };
    if options.lags_s.is_empty() || options.penalties.is_empty() {
        return wrong("number of lags or penalties", 0.0, "at least one of each");
    }
    if let Some(&lag) = options
        .lags_s
        .iter()
        .find(|lag| !(**lag >= 0.0 && lag.is_finite()))
    {
        return wrong("lag, s", lag, "0 or more");
    }
    match options
        .penalties
        .iter()
        .find(|p| !(**p > 0.0 && p.is_finite()))
    {
        Some(&penalty) => wrong("penalty", penalty, "a positive number"),
        None => Ok(()),
    }
}

impl ThermalFit {
    /// The displacement that the terms predict in every row of a record with the same sensors; lags start at its
    /// first row.
    pub fn predict(&self, record: &ThermalRecord) -> Vec<f64> {
        let mut predicted = vec![self.constant; record.len()];
        for term in &self.terms {
            let used = record.degc.iter().zip(&self.start_degc).zip(&term.per_k);
            for ((degc, start), per_k) in used.filter(|(_, per_k)| **per_k != 0.0) {
                let difference: Vec<f64> = degc.iter().map(|t| t - start).collect();
                for (sum, k) in
                    predicted
                        .iter_mut()
                        .zip(lagged(&record.time_s, &difference, term.lag_s))
                {
                    *sum += per_k * k;
                }
            }
        }
        predicted
    }

    /// Root mean square of record minus prediction in some rows, and the worst of ten equal stretches of them.
    pub fn residual(
        &self,
        record: &ThermalRecord,
        rows: Range<usize>,
    ) -> (f64, Option<ThermalSegment>) {
        let predicted = self.predict(record);
        let rows = rows.start.min(record.len())..rows.end.min(record.len());
        let error = |row: usize| record.displacement[row] - predicted[row];
        let segments = split(&rows, 10.min(rows.len())).into_iter();
        let worst = segments.map(|part| ThermalSegment {
            from_s: record.time_s[part.start],
            to_s: record.time_s[part.end - 1],
            rms: rms(part.map(error)),
        });
        let worst = worst.max_by(|a, b| a.rms.total_cmp(&b.rms));
        (rms(rows.map(error)), worst)
    }

    /// The sensors that count.
    pub fn sensors(&self) -> Vec<usize> {
        let counts = |sensor: &usize| self.terms.iter().any(|term| term.per_k[*sensor] != 0.0);
        (0..self.start_degc.len()).filter(counts).collect()
    }

    /// The displacement with every sensor at `reference_degc`, from which the terms of a machine file count.
    pub fn constant_at(&self, reference_degc: f64) -> f64 {
        let terms = self
            .terms
            .iter()
            .flat_map(|term| term.per_k.iter().zip(&self.start_degc));
        self.constant
            + terms
                .map(|(per_k, start)| per_k * (reference_degc - start))
                .sum::<f64>()
    }
}

/// The first-order lag of a signal, exact for steps, beginning at its first value.
fn lagged(time_s: &[f64], signal: &[f64], lag_s: f64) -> Vec<f64> {
    let Some(&first) = signal.first() else {
        return Vec::new();
    };
    let (mut value, mut before) = (first, time_s[0]);
    let step = |(&time, &input): (&f64, &f64)| {
        if lag_s > 0.0 {
            value = input + (value - input) * (-(time - before) / lag_s).exp();
            before = time;
            value
        } else {
            input
        }
    };
    time_s.iter().zip(signal).map(step).collect()
}

/// `parts` stretches of rows as equal as can be.
fn split(rows: &Range<usize>, parts: usize) -> Vec<Range<usize>> {
    let end = |part: usize| rows.start + rows.len() * part / parts.max(1);
    (0..parts).map(|part| end(part)..end(part + 1)).collect()
}

/// Every lag of every sensor, as differences to the first row: `columns[lag × sensors + sensor]`.
struct Features {
    sensors: usize,
    lags: usize,
    start_degc: Vec<f64>,
    columns: Vec<Vec<f64>>,
}

impl Features {
    fn new(record: &ThermalRecord, lags_s: &[f64]) -> Self {
        let start_degc: Vec<f64> = record.degc.iter().map(|column| column[0]).collect();
        let column = |lag_s: f64, sensor: usize| {
            let difference: Vec<f64> = record.degc[sensor]
                .iter()
                .map(|t| t - start_degc[sensor])
                .collect();
            lagged(&record.time_s, &difference, lag_s)
        };
        let sensors = record.degc.len();
        let columns = lags_s
            .iter()
            .flat_map(|&lag_s| (0..sensors).map(move |sensor| (lag_s, sensor)));
        Self {
            columns: columns
                .map(|(lag_s, sensor)| column(lag_s, sensor))
                .collect(),
            sensors,
            lags: lags_s.len(),
            start_degc,
        }
    }

    /// Σ z zᵀ over every `stride`-th row, z = (1, displacement, features).
    fn moments(&self, record: &ThermalRecord, rows: Range<usize>, stride: usize) -> DMatrix<f64> {
        let rows: Vec<usize> = rows.step_by(stride).collect();
        let entry = |row: usize, column: usize| match column {
            0 => 1.0,
            1 => record.displacement[rows[row]],
            _ => self.columns[column - BEFORE][rows[row]],
        };
        let z = DMatrix::from_fn(rows.len(), BEFORE + self.columns.len(), entry);
        z.tr_mul(&z)
    }
}

/// The best of all lags alone and in pairs with every penalty; where sensors are selected, those that the best
/// choice misses.
fn best_choices(
    features: &Features,
    record: &ThermalRecord,
    train: &Range<usize>,
    options: &ThermalOptions,
) -> Result<Vec<ThermalChoice>, FitError> {
    let stride = train.len().div_ceil(ROWS_TO_CHOOSE);
    let blocks: Vec<DMatrix<f64>> = split(train, BLOCKS)
        .into_iter()
        .map(|rows| features.moments(record, rows, stride))
        .collect();
    let all: Vec<usize> = (0..features.sensors).collect();
    let mut choices = every_choice(features, &blocks, options, &all);
    if options.select_sensors
        && let Some(best) = choices.first()
    {
        let sensors = best.clone().without_needless(features, &blocks).sensors;
        choices = every_choice(features, &blocks, options, &sensors);
    }
    choices.truncate(options.mean_of.max(1));
    let most = choices
        .first()
        .map_or(0.0, |best| MEAN_WITHIN * best.forward_rms);
    choices.retain(|choice| choice.forward_rms <= most);
    if choices.is_empty() {
        return Err(FitError::Undetermined {
            coefficients: features.sensors,
        });
    }
    Ok(choices)
}

/// Every choice with some sensors that can be validated, the best first.
fn every_choice(
    features: &Features,
    blocks: &[DMatrix<f64>],
    options: &ThermalOptions,
    sensors: &[usize],
) -> Vec<ThermalChoice> {
    let pairs = (0..features.lags).flat_map(|a| (a..features.lags).map(move |b| (a, b)));
    let choice = |(a, b), &penalty: &f64| {
        let lags = if a == b { vec![a] } else { vec![a, b] };
        let mut choice = ThermalChoice {
            lags,
            sensors: sensors.to_vec(),
            penalty,
            forward_rms: f64::INFINITY,
        };
        choice.forward_rms = choice.validated(features, blocks);
        choice
    };
    let tried = pairs.flat_map(|pair| {
        options
            .penalties
            .iter()
            .map(move |penalty| choice(pair, penalty))
    });
    let mut choices: Vec<ThermalChoice> = tried
        .filter(|choice| choice.forward_rms.is_finite())
        .collect();
    choices.sort_by(|a, b| a.forward_rms.total_cmp(&b.forward_rms));
    choices
}

impl ThermalChoice {
    /// Its columns among the moments.
    fn columns(&self, features: &Features) -> Vec<usize> {
        let column = |lag: &usize, sensor: &usize| BEFORE + lag * features.sensors + sensor;
        let of_lag = |lag| self.sensors.iter().map(move |sensor| column(lag, sensor));
        self.lags.iter().flat_map(of_lag).collect()
    }

    /// Leaves out one sensor after the other, the one whose loss helps most first.
    fn without_needless(mut self, features: &Features, blocks: &[DMatrix<f64>]) -> Self {
        while self.sensors.len() > 1 {
            let without = |place: usize| {
                let mut tried = self.clone();
                tried.sensors.remove(place);
                tried.forward_rms = tried.validated(features, blocks);
                tried
            };
            let tried = (0..self.sensors.len()).map(without);
            match tried.min_by(|a, b| a.forward_rms.total_cmp(&b.forward_rms)) {
                Some(better) if better.forward_rms <= self.forward_rms => self = better,
                _ => break,
            }
        }
        self
    }

    /// Root mean square of predicting each block from all before it.
    fn validated(&self, features: &Features, blocks: &[DMatrix<f64>]) -> f64 {
        let plan = self.columns(features);
        let mut past = &blocks[0] + &blocks[1];
        let (mut sum, mut count) = (0.0, 0.0);
        for block in &blocks[2..] {
            let Some(ridge) = ridge(&past, &plan, self.penalty) else {
                return f64::INFINITY;
            };
            sum += ridge.squared_error(block, &plan);
            count += block[(0, 0)];
            past += block;
        }
        (sum / count).sqrt()
    }
}

/// A ridge regression: weights of the planned columns, and the constant.
struct Ridge {
    weights: Vec<f64>,
    constant: f64,
}

impl Ridge {
    /// Σ of squared errors over the rows of some moments.
    fn squared_error(&self, moments: &DMatrix<f64>, plan: &[usize]) -> f64 {
        // The error is v·z with v = (−constant, 1, −weights).
        let v: Vec<(usize, f64)> = [(0, -self.constant), (1, 1.0)]
            .into_iter()
            .chain(plan.iter().copied().zip(self.weights.iter().map(|w| -w)))
            .collect();
        let product =
            |&(i, a): &(usize, f64)| v.iter().map(|&(j, b)| a * b * moments[(i, j)]).sum::<f64>();
        v.iter().map(product).sum::<f64>().max(0.0)
    }
}

/// Ridge regression from moments, features scaled to unit variance; one that stands still gets no weight.
fn ridge(moments: &DMatrix<f64>, plan: &[usize], penalty: f64) -> Option<Ridge> {
    let rows = moments[(0, 0)];
    let mean = |column: usize| moments[(0, column)] / rows;
    let covariance = |a: usize, b: usize| moments[(a, b)] / rows - mean(a) * mean(b);
    // 1e-4 K of movement is no movement.
    let scales: Vec<f64> = plan
        .iter()
        .map(|&c| covariance(c, c).max(0.0).sqrt())
        .map(|s| if s > 1e-4 { 1.0 / s } else { 0.0 })
        .collect();
    if scales.iter().all(|scale| *scale == 0.0) {
        return None;
    }
    let correlation = DMatrix::from_fn(plan.len(), plan.len(), |i, j| {
        covariance(plan[i], plan[j]) * scales[i] * scales[j] + if i == j { penalty } else { 0.0 }
    });
    let right = DVector::from_fn(plan.len(), |i, _| covariance(plan[i], 1) * scales[i]);
    let solved = Cholesky::new(correlation)?.solve(&right);
    let weights: Vec<f64> = solved
        .iter()
        .zip(&scales)
        .map(|(w, scale)| w * scale)
        .collect();
    let constant = mean(1)
        - weights
            .iter()
            .zip(plan)
            .map(|(w, &column)| w * mean(column))
            .sum::<f64>();
    Some(Ridge { weights, constant })
}
