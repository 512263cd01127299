//! Result of the search for thermal terms: each coefficient with its uncertainty, and the tested range of temperatures.

use std::ops::Range;

use volcomp_curve::SmoothedRate;

use super::{
    columns::{Between, Column, ThermalEffect},
    fitted::{ThermalSegment, judged},
    runs::ThermalRun,
};
use crate::fit::rms;

/// Coefficient of a thermal term.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalNumber {
    /// Index of the sensor in [`ThermalRecord::degc`](crate::ThermalRecord::degc).
    pub sensor: usize,
    /// Quantity that the coefficient multiplies.
    pub effect: ThermalEffect,
    /// Value, µm/K or µrad/K; for an expansion per K and mm.
    pub value: f64,
    /// Standard uncertainty, in the same unit.
    pub uncertainty: f64,
}

/// The error of validation with so many numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ThermalSize {
    /// Number of numbers.
    pub numbers: usize,
    /// Root mean square of the errors of validation, µm or µrad.
    pub rms: f64,
    /// Its standard error over the runs or stretches.
    pub standard_error: f64,
}

/// Range of temperatures and rates of a sensor in the tests.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalSeen {
    /// Index of the sensor.
    pub sensor: usize,
    /// Lowest and highest temperature, °C.
    pub degc: [f64; 2],
    /// Fastest fall and rise, K/min, by [`SmoothedRate`].
    pub k_per_min: [f64; 2],
}

/// Thermal terms found by a search.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalTerms {
    /// Coefficients.
    pub numbers: Vec<ThermalNumber>,
    /// Ridge penalty of the regression.
    pub penalty: f64,
    /// Validation error by number of coefficients, from many to one.
    pub path: Vec<ThermalSize>,
    /// Root mean square validation error with these coefficients in each run or stretch, µm or µrad.
    pub validated: Vec<f64>,
    /// Tested ranges of the sensors in use.
    pub seen: Vec<ThermalSeen>,
    /// For each position of each run: the displacement with all temperatures at those of its first row, µm or µrad; these temperatures, °C; and the
    /// position, mm.
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
    /// `offsets`: mean error of the coefficients for each position of each run, relative to its start. `lags_s`: time constants available to the
    /// search, s.
    pub(super) fn new(
        numbers: Vec<ThermalNumber>,
        penalty: f64,
        path: Vec<ThermalSize>,
        validated: Vec<f64>,
        known: &[(&ThermalRun, Range<usize>)],
        offsets: &[((usize, usize), f64)],
        lags_s: &[f64],
    ) -> Self {
        let mut terms = Self {
            seen: Vec::new(),
            zeros: Vec::new(),
            numbers,
            penalty,
            path,
            validated,
        };
        terms.seen = terms.sensors().iter().map(|&s| seen(known, s)).collect();
        for (index, (run, _)) in known.iter().enumerate() {
            let (positions, places) = run.places();
            let from_start = terms.unknown_zero(run, Between::Straight);
            let of_run = run.record.known_rows(&(0..run.record.len()), lags_s);
            let zero_rows = ThermalRun::zero_rows(&of_run, &places, positions.len());
            for (place, (&position_mm, rows)) in positions.iter().zip(&zero_rows).enumerate() {
                let offset = offsets.iter().find(|(key, _)| *key == (index, place));
                let Some((_, offset)) = offset else { continue };
                let misses = rows
                    .iter()
                    .map(|&row| run.record.displacement[row] - from_start[row]);
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

    /// Indices of the sensors in use, ascending.
    pub fn sensors(&self) -> Vec<usize> {
        let mut sensors: Vec<usize> = self.numbers.iter().map(|number| number.sensor).collect();
        sensors.sort_unstable();
        sensors.dedup();
        sensors
    }

    /// Time constants in use, s, ascending.
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

    /// Prediction from the temperatures of a run with the same sensors, relative to its first row.
    fn unknown_zero(&self, run: &ThermalRun, between: Between) -> Vec<f64> {
        let mut sum = vec![0.0; run.record.len()];
        for number in &self.numbers {
            let column = Column {
                sensor: number.sensor,
                effect: number.effect,
            };
            for (sum, value) in sum.iter_mut().zip(column.values(run, between)) {
                *sum += number.value * value;
            }
        }
        sum
    }

    /// Root mean square of record minus prediction (µm or µrad) in a run that was not used for the terms, both relative to their start at each
    /// position. Rows that a gap excludes are skipped.
    pub fn rms_from_start(&self, run: &ThermalRun) -> f64 {
        let predicted = self.unknown_zero(run, Between::Straight);
        let rows = run.record.displacement.iter().zip(&predicted);
        let errors: Vec<f64> = rows.map(|(d, p)| d - p).collect();
        run.rms_of_errors(&errors, &self.lags_s())
    }

    /// Error of the prediction of a run (root mean square, µm or µrad) from the unknown temperatures between its rows: the difference between
    /// temperatures that curve between the rows and linear ones. A machine that reads its sensors in every cycle has this error in addition to what
    /// the rows of the run show.
    pub fn rms_between_rows(&self, run: &ThermalRun) -> f64 {
        let bent = self.unknown_zero(run, Between::Bent);
        let straight = self.unknown_zero(run, Between::Straight);
        let known = run
            .record
            .known_rows(&(0..run.record.len()), &self.lags_s());
        rms(known.iter().map(|&row| bent[row] - straight[row]))
    }

    /// Record minus prediction in every row of the run that the terms were found from, or of a part of it.
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

    /// Root mean square of [`errors`](Self::errors) (µm or µrad) over some rows of the run that the terms were found from, and the worst of ten equal
    /// stretches of them. Rows that are not in the run or that a gap excludes are skipped; without any row the result is NaN.
    pub fn residual(&self, run: &ThermalRun, rows: Range<usize>) -> (f64, Option<ThermalSegment>) {
        let known = run.record.known_rows(&rows, &self.lags_s());
        judged(&run.record.time_s, &self.errors(run), &known)
    }

    /// Displacement with every sensor at `reference_degc`, the temperature that the terms of a machine file refer to: its mean over runs and
    /// positions, and the range.
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

/// Range of a sensor over some rows of some runs.
fn seen(known: &[(&ThermalRun, Range<usize>)], sensor: usize) -> ThermalSeen {
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
    ThermalSeen {
        sensor,
        degc,
        k_per_min,
    }
}
