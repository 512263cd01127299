//! Lagged temperatures as the columns of a regression.

use std::ops::Range;

use nalgebra::DMatrix;
use volcomp_curve::first_order_lag;

use super::record::ThermalRecord;

/// Columns of the moments before the features: 1 and the displacement.
pub(super) const BEFORE: usize = 2;

/// The first-order lag of a signal over time, beginning at its first value: as long as the shorter of both.
pub(super) fn lagged(time_s: &[f64], signal: &[f64], lag_s: f64) -> Vec<f64> {
    let mut state: Option<(f64, f64)> = None;
    let step = |(&time, &input): (&f64, &f64)| {
        let (before, value) = state.unwrap_or((time, input));
        let value = first_order_lag(value, input, time - before, lag_s);
        state = Some((time, value));
        value
    };
    time_s.iter().zip(signal).map(step).collect()
}

/// Rows divided into `parts` stretches that are as equal as can be.
pub(super) fn split(rows: &Range<usize>, parts: usize) -> Vec<Range<usize>> {
    let end = |part: usize| rows.start + rows.len() * part / parts.max(1);
    (0..parts).map(|part| end(part)..end(part + 1)).collect()
}

/// Every lag of every sensor, as differences to the first row: `columns[lag × sensors + sensor]`.
pub(super) struct Features {
    pub(super) sensors: usize,
    pub(super) lags: usize,
    pub(super) start_degc: Vec<f64>,
    columns: Vec<Vec<f64>>,
}

impl Features {
    pub(super) fn new(record: &ThermalRecord, lags_s: &[f64]) -> Self {
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
    pub(super) fn moments(
        &self,
        record: &ThermalRecord,
        rows: Range<usize>,
        stride: usize,
    ) -> DMatrix<f64> {
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
