//! Thermal tests as several runs, at one or several positions of the axis.

use super::record::ThermalRecord;
use crate::{FitError, fit::rms};

/// One thermal test: from its first row to its last, and where the axis stood.
///
/// A displacement counts from its first readings at each position: instruments are set to zero at the start of a test, and
/// the curve of the cold axis is no business of thermal terms.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalRun {
    /// Temperatures and displacement over time.
    pub record: ThermalRecord,
    /// Where the axis stood in each row, mm; empty where it did not move.
    pub position_mm: Vec<f64>,
}

/// The most positions of a run: each needs readings over the whole time.
const MOST_POSITIONS: usize = 100;
/// Rows of one position whose mean is its zero: a hundredth, at least 3 and at most 20.
const ZERO_ROWS: [usize; 2] = [3, 20];

impl From<ThermalRecord> for ThermalRun {
    fn from(record: ThermalRecord) -> Self {
        Self {
            record,
            position_mm: Vec::new(),
        }
    }
}

impl ThermalRun {
    /// Whether the axis stood at different positions.
    pub fn has_positions(&self) -> bool {
        self.position_mm.iter().any(|q| *q != self.position_mm[0])
    }

    /// Root mean square of the displacement (µm or µrad), counted from its start at each position: what is off where nothing is
    /// predicted.
    pub fn rms_from_start(&self) -> f64 {
        self.rms_of_errors(&self.record.displacement, &[])
    }

    /// Root mean square of errors, one for each row, counted from their start at each position: over the rows that gaps leave
    /// for terms with these time constants, s.
    pub(super) fn rms_of_errors(&self, errors: &[f64], lags_s: &[f64]) -> f64 {
        let known = self.record.known_rows(&(0..self.record.len()), lags_s);
        let (positions, places) = self.places();
        let zeros: Vec<f64> = Self::zero_rows(&known, &places, positions.len())
            .iter()
            .map(|rows| rows.iter().map(|row| errors[*row]).sum::<f64>() / rows.len().max(1) as f64)
            .collect();
        let from_start = known.iter().map(|&row| errors[row] - zeros[places[row]]);
        rms(from_start)
    }

    /// Its rows before this one.
    pub(super) fn until(&self, row: usize) -> Self {
        let first = |values: &Vec<f64>| values.iter().copied().take(row).collect();
        Self {
            record: ThermalRecord {
                time_s: first(&self.record.time_s),
                degc: self.record.degc.iter().map(first).collect(),
                displacement: first(&self.record.displacement),
            },
            position_mm: first(&self.position_mm),
        }
    }

    pub(super) fn check(&self, sensors: usize) -> Result<(), FitError> {
        self.record.check()?;
        if self.record.degc.len() != sensors {
            return Err(FitError::Lengths {
                abscissae: sensors,
                readings: self.record.degc.len(),
            });
        }
        if self.position_mm.is_empty() {
            return Ok(());
        }
        if self.position_mm.len() != self.record.len() {
            return Err(FitError::Lengths {
                abscissae: self.record.len(),
                readings: self.position_mm.len(),
            });
        }
        if let Some(index) = self.position_mm.iter().position(|q| !q.is_finite()) {
            return Err(FitError::NotFinite {
                what: "position",
                index,
                value: self.position_mm[index],
            });
        }
        let (positions, _) = self.places();
        if positions.len() > MOST_POSITIONS || 3 * positions.len() > self.record.len() {
            return Err(FitError::Parameter {
                what: "number of different positions of a thermal test",
                value: positions.len() as f64,
                expected: "at most 100, each with at least 3 rows",
            });
        }
        Ok(())
    }

    /// The different positions, rising, and for each row the place of its position among them.
    pub(super) fn places(&self) -> (Vec<f64>, Vec<usize>) {
        if self.position_mm.is_empty() {
            return (vec![0.0], vec![0; self.record.len()]);
        }
        let mut positions = self.position_mm.clone();
        positions.sort_by(f64::total_cmp);
        positions.dedup();
        let place = |q: &f64| positions.partition_point(|p| p.total_cmp(q).is_lt());
        let places = self.position_mm.iter().map(place).collect();
        (positions, places)
    }

    /// The rows of each position that are its zero, of those that are known.
    pub(super) fn zero_rows(known: &[usize], places: &[usize], count: usize) -> Vec<Vec<usize>> {
        let mut rows = vec![Vec::new(); count];
        for &row in known {
            rows[places[row]].push(row);
        }
        let [least, most] = ZERO_ROWS;
        for rows in &mut rows {
            rows.truncate((rows.len() / 100).clamp(least, most));
        }
        rows
    }
}
