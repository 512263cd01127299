//! Fitted thermal terms and their predictions.

use std::ops::Range;

use super::{choice::ThermalChoice, features::split, lagged::lagged, record::ThermalRecord};
use crate::fit::rms;

/// A drift term: the first-order lag of Σ per_k·(T − start) over the sensors.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalTerm {
    /// Time constant of the lag, s; 0 is no lag.
    pub lag_s: f64,
    /// Displacement per kelvin of each sensor, µm/K or µrad/K; 0 for an unused sensor.
    pub per_k: Vec<f64>,
}

/// Fitted drift terms, with the choices that they are averaged from.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalFit {
    /// Drift terms, one for each time constant used.
    pub terms: Vec<ThermalTerm>,
    /// Displacement with every sensor at its start, µm or µrad.
    pub constant: f64,
    /// Start temperatures, °C, from which differences are taken: those of the first row.
    pub start_degc: Vec<f64>,
    /// Root mean square error of the best choice over the blocks of the forward validation, µm or µrad.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub forward_rms: f64,
    /// Choices whose mean the terms are.
    pub choices: Vec<ThermalChoice>,
}

/// A stretch of time, and how far off a fit is in it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ThermalSegment {
    /// Time of its first row, s.
    pub from_s: f64,
    /// Time of its last row, s.
    pub to_s: f64,
    /// Root mean square of record minus prediction, µm or µrad.
    pub rms: f64,
}

impl ThermalFit {
    /// Predicted displacement in every row of a record with the same sensors; lags start at its first row.
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

    /// Root mean square of record minus prediction (µm or µrad) over some rows, and the worst of ten equal stretches of them. Rows that are not in
    /// the record or that a gap excludes are skipped; without any row the result is NaN.
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

    /// Indices of the sensors with a weight in any term.
    pub fn sensors(&self) -> Vec<usize> {
        let weight = |term: &ThermalTerm, sensor: usize| term.per_k.get(sensor).copied();
        let counts = |sensor: &usize| {
            let mut weights = self.terms.iter().filter_map(|term| weight(term, *sensor));
            weights.any(|per_k| per_k != 0.0)
        };
        (0..self.start_degc.len()).filter(counts).collect()
    }

    /// Displacement with every sensor at `reference_degc`, the temperature that the terms of a machine file refer to.
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

/// Root mean square error over some rows, and the worst of ten equal stretches of them; NaN without any row.
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
