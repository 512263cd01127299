//! Thermal tests as several runs, at one or several positions of the axis.

use super::record::ThermalRecord;
use crate::{FitError, fit::rms};

/// One thermal test, with the axis position in each row.
///
/// A displacement is relative to its first readings at each position: instruments are zeroed at the start of a test, and the error of the cold axis
/// is not thermal.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalRun {
    /// Temperatures and displacement over time.
    pub record: ThermalRecord,
    /// Axis position in each row, mm; empty if the axis did not move.
    pub position_mm: Vec<f64>,
}

/// Maximum number of positions of a run: each needs readings over the whole time.
const MOST_POSITIONS: usize = 100;
/// Number of rows of a position averaged for its zero: a hundredth of them, within these limits.
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
    /// Whether the axis was at different positions.
    pub fn has_positions(&self) -> bool {
        self.position_mm.iter().any(|q| *q != self.position_mm[0])
    }

    /// Root mean square of the displacement (µm or µrad) relative to its start at each position: the error without a prediction.
    pub fn rms_from_start(&self) -> f64 {
        self.rms_of_errors(&self.record.displacement, &[])
    }

    /// Root mean square of errors, one for each row, relative to their start at each position, over the rows that no gap excludes for terms with
    /// these time constants, s.
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

    /// The part of the run before this row.
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

    /// Different positions, ascending, and for each row the index of its position.
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

    /// Known rows of each position that define its zero.
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
