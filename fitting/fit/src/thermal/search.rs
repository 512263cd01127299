//! Search for sparse thermal terms: few sensors, few lags, and only coefficients whose removal increases the validation
//! error significantly.
//!
//! Several runs are validated by leaving out whole runs. A single run is validated by stretches of time, each predicted
//! from earlier stretches.

use std::ops::Range;

use super::{
    columns::{Between, Column, Stretch, Sums, ThermalEffect, stretches},
    enough_rows,
    options::ThermalOptions,
    record::ThermalRun,
    sensors::representative_sensors,
    terms::{ThermalNumber, ThermalSize, ThermalTerms},
};
use crate::FitError;

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
