//! Fitted thermal terms: predictions over time, and the result of the search with uncertainties and tested temperature
//! ranges.

use std::ops::Range;

use volcomp_curve::SmoothedRate;

use super::{
    choice::ThermalChoice,
    columns::{Between, Column, ThermalEffect, split},
    lagged::lagged,
    record::{ThermalRecord, ThermalRun},
};
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
