//! Lagged temperatures as the columns of a regression.

use nalgebra::DMatrix;

use super::{lagged::lagged, record::ThermalRecord};

/// Number of columns of the moments before the features: 1 and the displacement.
pub(super) const BEFORE: usize = 2;

/// Splits rows into `parts` stretches that are as equal as possible.
pub(super) fn split(rows: &[usize], parts: usize) -> impl Iterator<Item = &[usize]> {
    let end = move |part: usize| rows.len() * part / parts.max(1);
    (0..parts).map(move |part| &rows[end(part)..end(part + 1)])
}

/// Every lag of every sensor, relative to the first row: `columns[lag × sensors + sensor]`.
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
        rows: &[usize],
        stride: usize,
    ) -> DMatrix<f64> {
        let rows: Vec<usize> = rows.iter().copied().step_by(stride).collect();
        let entry = |row: usize, column: usize| match column {
            0 => 1.0,
            1 => record.displacement[rows[row]],
            _ => self.columns[column - BEFORE][rows[row]],
        };
        let z = DMatrix::from_fn(rows.len(), BEFORE + self.columns.len(), entry);
        z.tr_mul(&z)
    }
}
