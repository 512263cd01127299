//! The search for sparse thermal terms, and their predictions over time with uncertainties.
//!
//! The search selects few sensors and few lags, and only coefficients whose removal increases the validation error.
//! Several runs are validated by leaving out whole runs. A single run is validated by stretches of time, each predicted
//! from earlier stretches.

use std::ops::Range;

use nalgebra::{DMatrix, DVector};
use volcomp_curve::SmoothedRate;

use super::columns::{
    BEFORE, Between, Column, Features, Stretch, Sums, ThermalEffect, lagged, ridge, split,
    stretches,
};
use super::record::{ThermalOptions, ThermalRecord, ThermalRun, enough_rows};
use crate::FitError;
use crate::fit::rms;

/// A drift term: the first-order lag of the sum over the sensors of `per_k`·(T − start).
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalTerm {
    /// Time constant of the lag, s; 0 for no lag.
    pub lag_s: f64,
    /// Displacement per kelvin of each sensor, µm/K or µrad/K; 0 for an unused sensor.
    pub per_k: Vec<f64>,
}

/// Fitted drift terms, and the choices of which they are the average.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalFit {
    /// Drift terms, one for each time constant in use.
    pub terms: Vec<ThermalTerm>,
    /// Displacement with every sensor at its start temperature, µm or µrad.
    pub constant: f64,
    /// Start temperatures, °C, which are those of the first row. Temperature differences are relative to them.
    pub start_degc: Vec<f64>,
    /// Root mean square error of the best choice over the blocks of the forward validation, µm or µrad.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub forward_rms: f64,
    /// The choices of which the terms are the average.
    pub choices: Vec<ThermalChoice>,
}

/// A stretch of time, with the error of a fit in it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ThermalSegment {
    /// Time of the first row of the stretch, s.
    pub from_s: f64,
    /// Time of the last row of the stretch, s.
    pub to_s: f64,
    /// Root mean square of record minus prediction, µm or µrad.
    pub rms: f64,
}

impl ThermalFit {
    /// Predicted displacement, µm or µrad, in every row of a record with the same sensors. Lags start at the first row.
    pub fn predict(&self, record: &ThermalRecord) -> Vec<f64> {
        let mut predicted = vec![self.constant; record.len()];
        for term in &self.terms {
            let used = record.degc.iter().zip(&self.start_degc).zip(&term.per_k);
            for ((degc, start), per_k) in used.filter(|(_, per_k)| **per_k != 0.0) {
                let difference: Vec<f64> = degc.iter().map(|t| t - start).collect();
                for (sum, k) in
                    predicted.iter_mut().zip(lagged(&record.time_s, &difference, term.lag_s))
                {
                    *sum += per_k * k;
                }
            }
        }
        predicted
    }

    /// Root mean square of record minus prediction (µm or µrad) over `rows`, and the worst of ten equal stretches of
    /// these rows. Rows that are not in the record, or that a gap excludes, are skipped. If no row remains, the result
    /// is NaN.
    pub fn residual(
        &self,
        record: &ThermalRecord,
        rows: Range<usize>,
    ) -> (f64, Option<ThermalSegment>) {
        let predicted = self.predict(record);
        let errors = record.displacement.iter().zip(&predicted);
        let errors: Vec<f64> = errors.map(|(found, predicted)| found - predicted).collect();
        let lags: Vec<f64> = self.terms.iter().map(|term| term.lag_s).collect();
        judged(&record.time_s, &errors, &record.known_rows(&rows, &lags))
    }

    /// Indices of the sensors with a non-zero weight in any term.
    pub fn sensors(&self) -> Vec<usize> {
        let weight = |term: &ThermalTerm, sensor: usize| term.per_k.get(sensor).copied();
        let counts = |sensor: &usize| {
            let mut weights = self.terms.iter().filter_map(|term| weight(term, *sensor));
            weights.any(|per_k| per_k != 0.0)
        };
        (0..self.start_degc.len()).filter(counts).collect()
    }

    /// Displacement, µm or µrad, with every sensor at `reference_degc`. This is the temperature to which the terms of a
    /// machine file refer.
    pub fn constant_at(&self, reference_degc: f64) -> f64 {
        let terms = self.terms.iter().flat_map(|term| term.per_k.iter().zip(&self.start_degc));
        self.constant + terms.map(|(per_k, start)| per_k * (reference_degc - start)).sum::<f64>()
    }
}

/// Root mean square error over `rows`, and the worst of ten equal stretches of these rows; NaN if there is no row.
pub(super) fn judged(
    time_s: &[f64],
    errors: &[f64],
    rows: &[usize],
) -> (f64, Option<ThermalSegment>) {
    let of = |rows: &[usize]| rms(rows.iter().map(|row| errors[*row]));
    let segment = |part: &[usize]| {
        Some(ThermalSegment {
            from_s: time_s[*part.first()?],
            to_s: time_s[*part.last()?],
            rms: of(part),
        })
    };
    let worst = split(rows, 10.min(rows.len())).filter_map(segment);
    let worst = worst.max_by(|a, b| a.rms.total_cmp(&b.rms));
    (of(rows), worst)
}

/// Coefficient of a thermal term.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalNumber {
    /// Index of the sensor in [`ThermalRecord::degc`](crate::ThermalRecord::degc).
    pub sensor: usize,
    /// Quantity that the coefficient multiplies.
    pub effect: ThermalEffect,
    /// Value of the coefficient, µm/K or µrad/K; for an expansion, per K and mm.
    pub value: f64,
    /// Standard uncertainty of the value, in the same unit.
    pub uncertainty: f64,
}

/// Validation error by number of coefficients.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ThermalSize {
    /// Number of coefficients of the terms.
    pub numbers: usize,
    /// Root mean square validation error, µm or µrad.
    pub rms: f64,
    /// Standard error of `rms` over the runs or stretches.
    pub standard_error: f64,
}

/// Ranges of the temperature and of the rate of change of a sensor in the tests.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TestedRange {
    pub sensor: usize,
    /// Lowest and highest temperature, °C.
    pub degc: [f64; 2],
    /// Rates of the fastest fall and of the fastest rise, K/min, by [`SmoothedRate`].
    pub k_per_min: [f64; 2],
}

/// Thermal terms that a search has found.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalTerms {
    /// The remaining coefficients.
    pub numbers: Vec<ThermalNumber>,
    /// Ridge penalty of the regression.
    pub penalty: f64,
    /// Validation error by number of coefficients, starting with the most coefficients.
    pub path: Vec<ThermalSize>,
    /// Root mean square validation error of these coefficients in each run or stretch, µm or µrad.
    pub validated: Vec<f64>,
    /// Tested ranges of the sensors that the terms use.
    pub seen: Vec<TestedRange>,
    /// For each position of each run: the displacement with all temperatures as in the first row, µm or µrad; these
    /// temperatures, °C; and the position, mm.
    zeros: Vec<Zero>,
}

#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Zero {
    displacement: f64,
    degc: Vec<f64>,
    position_mm: f64,
}

impl ThermalTerms {
    /// Creates the terms. `offsets` is the mean residual (µm or µrad) for each (run, position), relative to the start
    /// of the run. `lags_s` are the time constants among which the search chose, s.
    pub(super) fn new(
        numbers: Vec<ThermalNumber>,
        penalty: f64,
        path: Vec<ThermalSize>,
        validated: Vec<f64>,
        known: &[(&ThermalRun, Range<usize>)],
        offsets: &[((usize, usize), f64)],
        lags_s: &[f64],
    ) -> Self {
        let mut terms =
            Self { seen: Vec::new(), zeros: Vec::new(), numbers, penalty, path, validated };
        terms.seen = terms.sensors().iter().map(|&s| seen(known, s)).collect();
        for (index, (run, _)) in known.iter().enumerate() {
            let (positions, places) = run.places();
            let from_start = terms.unknown_zero(run, Between::Straight);
            let of_run = run.record.known_rows(&(0..run.record.len()), lags_s);
            let zero_rows = ThermalRun::zero_rows(&of_run, &places, positions.len());
            for (place, (&position_mm, rows)) in positions.iter().zip(&zero_rows).enumerate() {
                let offset = offsets.iter().find(|(key, _)| *key == (index, place));
                let Some((_, offset)) = offset else { continue };
                let misses = rows.iter().map(|&row| run.record.displacement[row] - from_start[row]);
                let start = misses.sum::<f64>() / rows.len().max(1) as f64;
                terms.zeros.push(Zero {
                    displacement: start + offset,
                    degc: run.record.degc.iter().map(|degc| degc[0]).collect(),
                    position_mm,
                });
            }
        }
        terms
    }

    /// Indices of the sensors that the terms use, ascending.
    pub fn sensors(&self) -> Vec<usize> {
        let mut sensors: Vec<usize> = self.numbers.iter().map(|number| number.sensor).collect();
        sensors.sort_unstable();
        sensors.dedup();
        sensors
    }

    /// Time constants that the terms use, s, ascending.
    pub fn lags_s(&self) -> Vec<f64> {
        let lag = |number: &ThermalNumber| match number.effect {
            ThermalEffect::Drift { lag_s } => Some(lag_s),
            ThermalEffect::Expansion => None,
        };
        let mut lags: Vec<f64> = self.numbers.iter().filter_map(lag).collect();
        lags.sort_by(f64::total_cmp);
        lags.dedup();
        lags
    }

    /// Prediction, µm or µrad, from the temperatures of a run with the same sensors, relative to the prediction in the
    /// first row.
    fn unknown_zero(&self, run: &ThermalRun, between: Between) -> Vec<f64> {
        let mut sum = vec![0.0; run.record.len()];
        for number in &self.numbers {
            let column = Column { sensor: number.sensor, effect: number.effect };
            for (sum, value) in sum.iter_mut().zip(column.values(run, between)) {
                *sum += number.value * value;
            }
        }
        sum
    }

    /// Root mean square of record minus prediction (µm or µrad) in a run that was not used to find the terms. Record
    /// and prediction are relative to their start at each position. Rows that a gap excludes are skipped.
    pub fn rms_from_start(&self, run: &ThermalRun) -> f64 {
        let predicted = self.unknown_zero(run, Between::Straight);
        let rows = run.record.displacement.iter().zip(&predicted);
        let errors: Vec<f64> = rows.map(|(d, p)| d - p).collect();
        run.rms_of_errors(&errors, &self.lags_s())
    }

    /// Error of the prediction of a run (root mean square, µm or µrad) due to the unknown temperatures between its
    /// rows. It is the difference between predictions with curved and with linear temperatures between the rows. A
    /// machine that reads its sensors in every cycle has this error in addition to the error in the rows of the run.
    pub fn rms_between_rows(&self, run: &ThermalRun) -> f64 {
        let bent = self.unknown_zero(run, Between::Bent);
        let straight = self.unknown_zero(run, Between::Straight);
        let known = run.record.known_rows(&(0..run.record.len()), &self.lags_s());
        rms(known.iter().map(|&row| bent[row] - straight[row]))
    }

    /// Record minus prediction, µm or µrad, in every row. The run must be the run, or a part of it, from which the
    /// terms were found.
    pub fn errors(&self, run: &ThermalRun) -> Vec<f64> {
        let predicted = self.unknown_zero(run, Between::Straight);
        let (positions, places) = run.places();
        let zero = |place: usize| {
            let mut zeros = self.zeros.iter();
            zeros.find(|zero| zero.position_mm == positions[place])
        };
        let rows = run.record.displacement.iter().zip(&predicted).zip(&places);
        rows.map(|((d, p), place)| d - p - zero(*place).map_or(0.0, |zero| zero.displacement))
            .collect()
    }

    /// Root mean square of [`errors`](Self::errors) (µm or µrad) over `rows` of the run from which the terms were
    /// found, and the worst of ten equal stretches of these rows. Rows that are not in the run, or that a gap excludes,
    /// are skipped. If no row remains, the result is NaN.
    pub fn residual(&self, run: &ThermalRun, rows: Range<usize>) -> (f64, Option<ThermalSegment>) {
        let known = run.record.known_rows(&rows, &self.lags_s());
        judged(&run.record.time_s, &self.errors(run), &known)
    }

    /// Displacement with every sensor at `reference_degc`, the temperature to which the terms of a machine file refer.
    /// Returns its mean over the positions of all runs, and its maximum minus its minimum, both in µm or µrad.
    pub fn constant_at(&self, reference_degc: f64) -> (f64, f64) {
        let at = |zero: &Zero| {
            let per_k = |number: &ThermalNumber| match number.effect {
                ThermalEffect::Drift { .. } => number.value,
                ThermalEffect::Expansion => number.value * zero.position_mm,
            };
            let numbers = self.numbers.iter();
            let steps = numbers.map(|n| per_k(n) * (reference_degc - zero.degc[n.sensor]));
            zero.displacement + steps.sum::<f64>()
        };
        let constants: Vec<f64> = self.zeros.iter().map(at).collect();
        let mean = constants.iter().sum::<f64>() / constants.len().max(1) as f64;
        let least = constants.iter().copied().fold(f64::INFINITY, f64::min);
        let most = constants.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        (mean, (most - least).max(0.0))
    }
}

fn seen(known: &[(&ThermalRun, Range<usize>)], sensor: usize) -> TestedRange {
    let mut degc = [f64::INFINITY, f64::NEG_INFINITY];
    let mut k_per_min = [0.0_f64; 2];
    for (run, rows) in known {
        let (mut rate, mut before) = (SmoothedRate::default(), None);
        for row in 0..rows.end.min(run.record.len()) {
            let (time_s, value) = (run.record.time_s[row], run.record.degc[sensor][row]);
            let step_s = before.map_or(0.0, |before| time_s - before);
            before = Some(time_s);
            let per_min = 60.0 * rate.step(value, step_s);
            degc = [degc[0].min(value), degc[1].max(value)];
            k_per_min = [k_per_min[0].min(per_min), k_per_min[1].max(per_min)];
        }
    }
    TestedRange { sensor, degc, k_per_min }
}

/// Maximum number of rows from which lags and penalty are chosen. Neighbouring rows are nearly equal, so more rows do
/// not change the choice.
const ROWS_TO_CHOOSE: usize = 2000;
/// Number of time blocks of the forward validation. The first two are used only for training.
pub(super) const BLOCKS: usize = 10;
/// Maximum ratio of the error of a choice to the error of the best choice. Worse choices are not averaged.
const MEAN_WITHIN: f64 = 1.25;

/// Lags, sensors and penalty of one regression.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalChoice {
    /// Indices of the time constants of this choice in [`ThermalOptions::lags_s`].
    pub lags: Vec<usize>,
    /// Indices of the sensors of this choice in [`ThermalRecord::degc`](crate::ThermalRecord::degc).
    pub sensors: Vec<usize>,
    /// Penalty of the ridge regression, as a fraction of the variance of a feature.
    pub penalty: f64,
    /// Root mean square prediction error over the blocks of the forward validation, µm or µrad.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub forward_rms: f64,
}

/// The best choices among all single lags and all pairs of lags, with every penalty. With sensor selection, they use
/// only the sensors that the best choice needs.
pub(super) fn best_choices(
    features: &Features,
    record: &ThermalRecord,
    train: &[usize],
    options: &ThermalOptions,
) -> Result<Vec<ThermalChoice>, FitError> {
    let stride = train.len().div_ceil(ROWS_TO_CHOOSE);
    let blocks: Vec<DMatrix<f64>> =
        split(train, BLOCKS).map(|rows| features.moments(record, rows, stride)).collect();
    let all: Vec<usize> = (0..features.sensors).collect();
    let mut choices = every_choice(features, &blocks, options, &all);
    if options.select_sensors
        && let Some(best) = choices.first()
    {
        let sensors = best.clone().without_needless(features, &blocks).sensors;
        choices = every_choice(features, &blocks, options, &sensors);
    }
    choices.truncate(options.mean_of.max(1));
    let most = choices.first().map_or(0.0, |best| MEAN_WITHIN * best.forward_rms);
    choices.retain(|choice| choice.forward_rms <= most);
    if choices.is_empty() {
        return Err(FitError::Undetermined { coefficients: features.sensors });
    }
    Ok(choices)
}

fn every_choice(
    features: &Features,
    blocks: &[DMatrix<f64>],
    options: &ThermalOptions,
    sensors: &[usize],
) -> Vec<ThermalChoice> {
    let pairs = (0..features.lags).flat_map(|a| (a..features.lags).map(move |b| (a, b)));
    let choice = |(a, b), &penalty: &f64| {
        let lags = if a == b { vec![a] } else { vec![a, b] };
        let mut choice =
            ThermalChoice { lags, sensors: sensors.to_vec(), penalty, forward_rms: f64::INFINITY };
        choice.forward_rms = choice.validated(features, blocks);
        choice
    };
    let tried =
        pairs.flat_map(|pair| options.penalties.iter().map(move |penalty| choice(pair, penalty)));
    let mut choices: Vec<ThermalChoice> =
        tried.filter(|choice| choice.forward_rms.is_finite()).collect();
    choices.sort_by(|a, b| a.forward_rms.total_cmp(&b.forward_rms));
    choices
}

impl ThermalChoice {
    pub(super) fn columns(&self, features: &Features) -> Vec<usize> {
        let column = |lag: &usize, sensor: &usize| BEFORE + lag * features.sensors + sensor;
        let of_lag = |lag| self.sensors.iter().map(move |sensor| column(lag, sensor));
        self.lags.iter().flat_map(of_lag).collect()
    }

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

    /// RMS error of predicting the third and every later block from the blocks before it; infinite if a fit fails.
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

/// Level of noise, K. A sensor whose mean movement is smaller has less weight.
const NOISE_K: f64 = 0.05;
/// Movement below which a sensor counts as constant, K.
const STILL_K: f64 = 1e-3;
/// A sensor counts as redundant if the chosen sensors leave less than this fraction of its variance.
const MIN_SHARE: f64 = 1e-6;
const MAX_ROWS: usize = 2000;

/// Chooses sensors one after the other. Each time, the sensor is chosen that, together with the sensors chosen before,
/// explains most of the movement of all sensors, each scaled by its own movement. Displacements are ignored, because
/// among many correlated sensors they would select the sensor whose noise fits best by chance.
fn representative_sensors(runs: &[(&ThermalRun, Range<usize>)], most: usize) -> Vec<usize> {
    let sensors = runs.first().map_or(0, |(run, _)| run.record.degc.len());
    let mut columns: Vec<DVector<f64>> = (0..sensors)
        .map(|sensor| {
            let moved = runs.iter().flat_map(|(run, rows)| {
                let step = rows.len().div_ceil(MAX_ROWS).max(1);
                let degc = &run.record.degc[sensor];
                let taken: Vec<f64> = rows.clone().step_by(step).map(|row| degc[row]).collect();
                let mean = taken.iter().sum::<f64>() / taken.len().max(1) as f64;
                taken.into_iter().map(move |degc| degc - mean)
            });
            let moved: Vec<f64> = moved.collect();
            let rms = (moved.iter().map(|x| x * x).sum::<f64>() / moved.len().max(1) as f64).sqrt();
            let scale = if rms > STILL_K { rms.max(NOISE_K) } else { f64::INFINITY };
            DVector::from_vec(moved) / scale
        })
        .collect();
    let mut chosen = Vec::new();
    let initial: Vec<f64> = columns.iter().map(DVector::norm_squared).collect();
    while chosen.len() < most {
        let products = DMatrix::from_fn(sensors, sensors, |i, j| columns[i].dot(&columns[j]));
        let left = |&sensor: &usize| {
            !chosen.contains(&sensor) && products[(sensor, sensor)] > MIN_SHARE * initial[sensor]
        };
        let explains =
            |sensor: usize| products.column(sensor).norm_squared() / products[(sensor, sensor)];
        let best = (0..sensors).filter(left).max_by(|a, b| explains(*a).total_cmp(&explains(*b)));
        let Some(best) = best else { break };
        let unit = columns[best].normalize();
        for column in &mut columns {
            let part = unit.dot(column);
            column.axpy(-part, &unit, 1.0);
        }
        chosen.push(best);
    }
    chosen
}

/// Number of stretches of a single run. The first two are used only for training.
const STRETCHES: usize = 10;
/// Penalty so small that it only keeps the equations solvable.
const MIN_PENALTY: f64 = 1e-9;
const MIN_STRETCHES: usize = 8;
const MIN_ROWS: usize = 20;

/// Limits of a search for thermal terms.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalSearch {
    /// Time constants to choose from, s; 0 for no lag. With expansions, 0 is always chosen too.
    pub lags_s: Vec<f64>,
    /// Ridge penalties to choose from, as fractions of the variance of the quantity that a coefficient multiplies. With
    /// small penalties, correlated sensors get large coefficients of opposite sign.
    pub penalties: Vec<f64>,
    /// Maximum number of sensors, at least 1.
    pub most_sensors: usize,
    /// Maximum number of time constants, at least 1.
    pub most_lags: usize,
    /// Whether to search for expansions, if the tests have different axis positions.
    pub expansions: bool,
}

impl Default for ThermalSearch {
    /// Ten time constants from 0 to 90 minutes, at most six sensors and at most three time constants.
    fn default() -> Self {
        Self {
            lags_s: ThermalOptions::default().lags_s,
            penalties: vec![1e-3, 1e-2, 1e-1],
            most_sensors: 6,
            most_lags: 3,
            expansions: true,
        }
    }
}

impl ThermalSearch {
    fn check(&self) -> Result<(), FitError> {
        ThermalOptions {
            lags_s: self.lags_s.clone(),
            penalties: self.penalties.clone(),
            ..ThermalOptions::default()
        }
        .check()?;
        for (what, found) in [("most sensors", self.most_sensors), ("most lags", self.most_lags)] {
            if found == 0 {
                return Err(FitError::Parameter { what, value: 0.0, expected: "at least 1" });
            }
        }
        Ok(())
    }

    /// Subsets of the ascending `lags` with at most `most_lags` elements, small subsets first.
    fn lag_sets(&self, lags: &[f64]) -> Vec<Vec<f64>> {
        let mut sets: Vec<Vec<f64>> = vec![Vec::new()];
        let mut last = sets.clone();
        for _ in 0..self.most_lags.min(lags.len()) {
            let longer = last.iter().flat_map(|set: &Vec<f64>| {
                let after = move |lag: &&f64| set.last().is_none_or(|last| *lag > last);
                let lags = lags.iter().filter(after);
                lags.map(move |lag| [&set[..], &[*lag]].concat())
            });
            last = longer.collect();
            sets.extend(last.iter().cloned());
        }
        sets.remove(0);
        sets
    }
}

/// Finds the terms of a displacement from one or more runs.
///
/// The sensors are those that explain most of the movement of all sensors. Time constants and penalty minimise the
/// validation error. Then coefficients are removed one after the other, each time the coefficient whose removal gives
/// the smallest error. The result is the candidate with the fewest coefficients whose error exceeds the smallest error
/// by at most one standard error.
///
/// # Errors
/// No run, runs with different sensors or too few rows, numbers that are not finite, or no sensor that changes.
pub fn search_thermal(
    runs: &[ThermalRun],
    search: &ThermalSearch,
) -> Result<ThermalTerms, FitError> {
    let whole: Vec<Range<usize>> = runs.iter().map(|run| 0..run.record.len()).collect();
    search_rows(runs, &whole, search)
}

/// Finds the terms of a displacement from some rows of one run.
///
/// # Errors
/// The errors of [`search_thermal`].
pub fn search_thermal_rows(
    run: &ThermalRun,
    rows: Range<usize>,
    search: &ThermalSearch,
) -> Result<ThermalTerms, FitError> {
    search_rows(std::slice::from_ref(run), &[rows], search)
}

/// Leave-one-run-out validation. For each run, returns the root mean square of record minus prediction (µm or µrad), by
/// terms that are found from all other runs. Record and prediction are relative to their start.
///
/// # Errors
/// The errors of [`search_thermal`], or fewer than two runs.
pub fn left_out_runs(runs: &[ThermalRun], search: &ThermalSearch) -> Result<Vec<f64>, FitError> {
    if runs.len() < 2 {
        return Err(FitError::TooFew {
            what: "runs",
            purpose: "leaving out runs",
            found: runs.len(),
            needed: 2,
        });
    }
    let judged = |left: usize| {
        let mut others = runs.to_vec();
        let run = others.remove(left);
        run.check(others[0].record.degc.len())?;
        Ok(search_thermal(&others, search)?.rms_from_start(&run))
    };
    (0..runs.len()).map(judged).collect()
}

fn search_rows(
    runs: &[ThermalRun],
    rows: &[Range<usize>],
    search: &ThermalSearch,
) -> Result<ThermalTerms, FitError> {
    search.check()?;
    let sensors = runs.first().map_or(0, |run| run.record.degc.len());
    let stretches_of_run =
        if runs.len() == 1 { STRETCHES } else { MIN_STRETCHES.div_ceil(runs.len().max(1)) };
    for (run, rows) in runs.iter().zip(rows) {
        run.check(sensors)?;
        let known = run.record.known_rows(rows, &search.lags_s);
        enough_rows(&run.record, rows, &known, stretches_of_run * MIN_ROWS)?;
    }
    let known: Vec<(&ThermalRun, Range<usize>)> = runs.iter().zip(rows.iter().cloned()).collect();
    let chosen = representative_sensors(&known, search.most_sensors);
    let space = Space::new(&known, &chosen, search, stretches_of_run);
    space.search(search, &known)
}

/// The columns to choose from, their sums over stretches, and the folds of the validation.
struct Space {
    /// Time constants to choose from, s, ascending.
    lags_s: Vec<f64>,
    expands: bool,
    columns: Vec<Column>,
    stretches: Vec<Stretch>,
    folds: Vec<Fold>,
}

struct Fold {
    learnt: Sums,
    judged: Vec<usize>,
}

/// Chosen columns and penalty, with the mean square error in each fold.
#[derive(Clone)]
struct Choice {
    columns: Vec<usize>,
    penalty: f64,
    errors: Vec<f64>,
}

impl Choice {
    fn mean(&self) -> f64 {
        self.errors.iter().sum::<f64>() / self.errors.len().max(1) as f64
    }

    fn standard_error(&self) -> f64 {
        let (mean, count) = (self.mean(), self.errors.len() as f64);
        let squares: f64 = self.errors.iter().map(|e| (e - mean).powi(2)).sum();
        (squares / (count - 1.0).max(1.0) / count).sqrt()
    }
}

impl Space {
    fn new(
        known: &[(&ThermalRun, Range<usize>)],
        sensors: &[usize],
        search: &ThermalSearch,
        parts: usize,
    ) -> Self {
        let mut lags = search.lags_s.clone();
        let expands = search.expansions
            && known.iter().any(|(run, _)| run.has_positions())
            // A run without positions has no information about an expansion.
            && known.iter().all(|(run, _)| !run.position_mm.is_empty());
        if expands {
            // An effect without lag is needed to locate the fixed point of an expansion.
            lags.push(0.0);
        }
        lags.sort_by(f64::total_cmp);
        lags.dedup();
        let drift = |&lag_s: &f64| {
            let effect = ThermalEffect::Drift { lag_s };
            sensors.iter().map(move |&sensor| Column { sensor, effect })
        };
        let mut columns: Vec<Column> = lags.iter().flat_map(drift).collect();
        if expands {
            let effect = ThermalEffect::Expansion;
            columns.extend(sensors.iter().map(|&sensor| Column { sensor, effect }));
        }
        let all = known.iter().enumerate();
        let stretches: Vec<Stretch> = all
            .flat_map(|(index, (run, rows))| {
                let between = Between::Straight;
                stretches(run, index, &columns, between, rows, &search.lags_s, parts)
            })
            .collect();
        let folds = if known.len() == 1 {
            let fold = |judged: usize| {
                let learnt = Sums::of(stretches[..judged].iter())?;
                Some(Fold { learnt, judged: vec![judged] })
            };
            (2..stretches.len()).filter_map(fold).collect()
        } else {
            let fold = |run: usize| {
                let learnt = Sums::of(stretches.iter().filter(|s| s.run != run))?;
                let of_run = (0..stretches.len()).filter(|place| stretches[*place].run == run);
                Some(Fold { learnt, judged: of_run.collect() })
            };
            (0..known.len()).filter_map(fold).collect()
        };
        Self { lags_s: lags, expands, columns, stretches, folds }
    }

    /// Validates a choice of columns and penalty; `None` if the data of a fold do not determine the weights.
    fn judged(&self, columns: Vec<usize>, penalty: f64) -> Option<Choice> {
        let error = |fold: &Fold| {
            let weights = fold.learnt.ridge(&columns, penalty)?;
            let errors = fold.judged.iter();
            let of =
                |place: &usize| fold.learnt.error_in(&self.stretches[*place], &columns, &weights);
            Some(errors.map(of).sum::<f64>() / fold.judged.len().max(1) as f64)
        };
        let errors = self.folds.iter().map(error).collect::<Option<Vec<f64>>>()?;
        Some(Choice { columns, penalty, errors })
    }

    /// Indices of the drift columns with these time constants, and of all expansion columns.
    fn with_lags(&self, lags: &[f64]) -> Vec<usize> {
        let takes = |column: &Column| match column.effect {
            ThermalEffect::Drift { lag_s } => lags.contains(&lag_s),
            ThermalEffect::Expansion => true,
        };
        let places = 0..self.columns.len();
        places.filter(|place| takes(&self.columns[*place])).collect()
    }

    /// The best choice of time constants and penalty, followed by choices that each have one coefficient fewer.
    fn path(&self, search: &ThermalSearch) -> Vec<Choice> {
        let mut best: Option<Choice> = None;
        let mut sets = search.lag_sets(&self.lags_s);
        // The fixed point of an expansion needs an effect without lag.
        sets.retain(|lags| !self.expands || lags.contains(&0.0));
        for lags in sets {
            for &penalty in &search.penalties {
                let choice = self.judged(self.with_lags(&lags), penalty);
                best = match (best, choice) {
                    (Some(best), Some(choice)) if choice.mean() < best.mean() => Some(choice),
                    (None, choice) => choice,
                    (best, _) => best,
                };
            }
        }
        let mut path: Vec<Choice> = best.into_iter().collect();
        while let Some(last) = path.last().filter(|last| last.columns.len() > 1) {
            let without = |place: usize| {
                let mut columns = last.columns.clone();
                columns.remove(place);
                self.judged(columns, last.penalty)
            };
            let tried = (0..last.columns.len()).filter_map(without);
            let Some(next) = tried.min_by(|a, b| a.mean().total_cmp(&b.mean())) else {
                break;
            };
            path.push(next);
        }
        path
    }

    fn search(
        &self,
        search: &ThermalSearch,
        known: &[(&ThermalRun, Range<usize>)],
    ) -> Result<ThermalTerms, FitError> {
        let path = self.path(search);
        let undetermined = || FitError::Undetermined { coefficients: self.columns.len() };
        let best = path.iter().min_by(|a, b| a.mean().total_cmp(&b.mean()));
        let best = best.ok_or_else(undetermined)?;
        let most = best.mean() + best.standard_error();
        let few = path.iter().rev().find(|choice| choice.mean() <= most);
        let choice = few.ok_or_else(undetermined)?;
        let sums = Sums::of(self.stretches.iter()).ok_or_else(undetermined)?;
        let weights = sums.ridge(&choice.columns, choice.penalty).ok_or_else(undetermined)?;
        // The penalty shrinks every coefficient towards zero, so the uncertainty includes the shrinkage.
        let drawn = sums.ridge(&choice.columns, MIN_PENALTY);
        let drawn = drawn.unwrap_or_else(|| weights.clone());
        let drawn = drawn.iter().zip(&weights).map(|(free, value)| free - value);
        // The temperatures between two rows are unknown in every run, so the uncertainty includes their effect.
        let bent = self.bent(choice, search, known);
        let bent = bent.unwrap_or_else(|| weights.clone());
        let bent = bent.iter().zip(&weights).map(|(bent, value)| bent - value);
        let uncertainties = (self.jackknife(choice).into_iter().zip(drawn).zip(bent))
            .map(|((spread, drawn), bent): ((f64, f64), f64)| spread.hypot(drawn).hypot(bent))
            .collect::<Vec<f64>>();
        let places = choice.columns.iter().zip(weights.iter().zip(uncertainties));
        let number = |(&place, (&value, uncertainty)): (&usize, (&f64, f64))| ThermalNumber {
            sensor: self.columns[place].sensor,
            effect: self.columns[place].effect,
            value,
            uncertainty,
        };
        let size = |choice: &Choice| ThermalSize {
            numbers: choice.columns.len(),
            rms: choice.mean().sqrt(),
            // Half the relative standard error of the mean square gives the relative standard error of the RMS.
            standard_error: 0.5 * choice.standard_error()
                / choice.mean().sqrt().max(f64::MIN_POSITIVE),
        };
        let offsets = sums.offsets(&choice.columns, &weights);
        Ok(ThermalTerms::new(
            places.map(number).collect(),
            choice.penalty,
            path.iter().map(size).collect(),
            choice.errors.iter().map(|e| e.sqrt()).collect(),
            known,
            &offsets,
            &search.lags_s,
        ))
    }

    /// Coefficients of a choice if temperatures are curved between the rows; `None` if the rows determine no
    /// coefficients.
    fn bent(
        &self,
        choice: &Choice,
        search: &ThermalSearch,
        known: &[(&ThermalRun, Range<usize>)],
    ) -> Option<Vec<f64>> {
        let columns: Vec<Column> = choice.columns.iter().map(|&c| self.columns[c]).collect();
        let of_run = |(index, (run, rows)): (usize, &(&ThermalRun, Range<usize>))| {
            // Take as many stretches as before, so that the same rows are used.
            let parts = self.stretches.len().div_ceil(known.len());
            // Later rows have no effect on earlier rows, so the run may end here.
            stretches(
                &run.until(rows.end),
                index,
                &columns,
                Between::Bent,
                rows,
                &search.lags_s,
                parts,
            )
        };
        let all: Vec<Stretch> = known.iter().enumerate().flat_map(of_run).collect();
        let places: Vec<usize> = (0..columns.len()).collect();
        Sums::of(all.iter())?.ridge(&places, choice.penalty)
    }

    /// Standard uncertainty of each coefficient by a delete-a-group jackknife over the stretches. Whole stretches
    /// account for the correlation of neighbouring rows.
    fn jackknife(&self, choice: &Choice) -> Vec<f64> {
        let without = |left: usize| {
            let others = self.stretches.iter().enumerate().filter(|(i, _)| *i != left);
            let sums = Sums::of(others.map(|(_, stretch)| stretch))?;
            sums.ridge(&choice.columns, choice.penalty)
        };
        let found: Vec<Vec<f64>> = (0..self.stretches.len()).filter_map(without).collect();
        let count = found.len().max(1) as f64;
        let spread = |number: usize| {
            let values = || found.iter().map(|weights| weights[number]);
            let mean = values().sum::<f64>() / count;
            let squares: f64 = values().map(|value| (value - mean).powi(2)).sum();
            (squares * (count - 1.0) / count).sqrt()
        };
        (0..choice.columns.len()).map(spread).collect()
    }
}
