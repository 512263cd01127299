//! The record of a thermal test: temperatures and displacements over time, and the options of its fit.
//!
//! A record may have gaps in its log, and runs at several positions of the axis.

use std::ops::Range;

use crate::FitError;
use crate::fit::rms;

/// A thermal test with temperatures and one displacement over time.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalRecord {
    /// Time of each row, s, increasing.
    pub time_s: Vec<f64>,
    /// Temperature of each sensor in each row, °C: `degc[sensor][row]`.
    pub degc: Vec<Vec<f64>>,
    /// Displacement in each row, µm or µrad.
    pub displacement: Vec<f64>,
}

impl ThermalRecord {
    pub fn len(&self) -> usize {
        self.time_s.len()
    }

    pub fn is_empty(&self) -> bool {
        self.time_s.is_empty()
    }

    pub(super) fn check(&self) -> Result<(), FitError> {
        let named = [("time", &self.time_s), ("displacement", &self.displacement)];
        let all = named.into_iter().chain(self.degc.iter().map(|column| ("temperature", column)));
        for (what, column) in all {
            if column.len() != self.len() {
                return Err(FitError::Lengths { abscissae: self.len(), readings: column.len() });
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

/// Minimum ratio of a gap to the median interval between rows.
const LONGER_THAN_USUAL: f64 = 10.0;
/// Minimum length of a gap, s. In a shorter time no temperature of a machine departs far from a straight line.
const MIN_GAP_S: f64 = 120.0;
/// Rows after a gap are used again when a lag depends on the temperature in the gap with less than this weight.
const FORGOTTEN: f64 = 0.05;

#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalGap {
    /// Time of the last row before the gap, s.
    pub from_s: f64,
    /// Time of the first row after the gap, s.
    pub to_s: f64,
    /// Rows after the gap that are excluded because a lag still depends on the gap; empty if there is no lag.
    pub left_out: Range<usize>,
}

impl ThermalRecord {
    /// Median interval between rows, s; 0 with fewer than two rows.
    pub fn usual_interval_s(&self) -> f64 {
        let mut steps: Vec<f64> = self.time_s.windows(2).map(|p| p[1] - p[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied().unwrap_or(0.0)
    }

    /// Gaps in the log. `lags_s` are the time constants of the terms, s.
    ///
    /// A gap is an interval of more than ten times the median interval and more than two minutes. After a gap of length
    /// g, a lag depends on the temperature in the gap with a weight of 1 − exp(−g/lag), which decays by exp(−t/lag)
    /// with the time t after the gap. Rows are excluded until this weight is below a twentieth.
    pub fn gaps(&self, lags_s: &[f64]) -> Vec<ThermalGap> {
        let lags = || lags_s.iter().copied().filter(|lag| *lag > 0.0);
        let least_s = MIN_GAP_S.max(LONGER_THAN_USUAL * self.usual_interval_s());
        let mut gaps = Vec::new();
        for (row, pair) in self.time_s.windows(2).enumerate() {
            let gap_s = pair[1] - pair[0];
            if gap_s > least_s {
                let forgets_s = |lag: f64| lag * (-(-gap_s / lag).exp_m1() / FORGOTTEN).ln();
                let known_s = pair[1] + lags().map(forgets_s).fold(0.0, f64::max);
                let end = self.time_s.partition_point(|time| *time < known_s);
                gaps.push(ThermalGap {
                    from_s: pair[0],
                    to_s: pair[1],
                    left_out: row + 1..end.max(row + 1),
                });
            }
        }
        gaps
    }

    /// Indices of the `rows` that no gap excludes. `lags_s` are the time constants of the terms, s.
    pub(super) fn known_rows(&self, rows: &Range<usize>, lags_s: &[f64]) -> Vec<usize> {
        let gaps = self.gaps(lags_s);
        let end = rows.end.min(self.len());
        (rows.start.min(end)..end)
            .filter(|row| !gaps.iter().any(|gap| gap.left_out.contains(row)))
            .collect()
    }
}

/// One thermal test, with the axis position in each row.
///
/// A displacement is relative to its first readings at each position, because instruments are zeroed at the start of a
/// test, and the error of the cold axis is not thermal.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalRun {
    /// Temperatures and displacement over time.
    pub record: ThermalRecord,
    /// Axis position in each row, mm; empty if the axis did not move.
    pub position_mm: Vec<f64>,
}

/// Maximum number of positions of a run. Each position needs readings over the whole time.
const MAX_POSITIONS: usize = 100;
/// Minimum and maximum number of rows that are averaged for the zero of a position. The number is a hundredth of the
/// rows of the position, within these limits.
const ZERO_ROWS: [usize; 2] = [3, 20];

impl From<ThermalRecord> for ThermalRun {
    fn from(record: ThermalRecord) -> Self {
        Self { record, position_mm: Vec::new() }
    }
}

impl ThermalRun {
    /// Whether the axis was at more than one position.
    pub fn has_positions(&self) -> bool {
        self.position_mm.iter().any(|q| *q != self.position_mm[0])
    }

    /// Root mean square of the displacement (µm or µrad) relative to its start at each position. This is the error
    /// without a prediction.
    pub fn rms_from_start(&self) -> f64 {
        self.rms_of_errors(&self.record.displacement, &[])
    }

    /// Root mean square of errors relative to their start at each position. `errors` has one error for each row. Rows
    /// that a gap excludes for the time constants `lags_s` (s) are omitted.
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
            return Err(FitError::Lengths { abscissae: sensors, readings: self.record.degc.len() });
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
        if positions.len() > MAX_POSITIONS || 3 * positions.len() > self.record.len() {
            return Err(FitError::Parameter {
                what: "number of different positions of a thermal test",
                value: positions.len() as f64,
                expected: "at most 100, each with at least 3 rows",
            });
        }
        Ok(())
    }

    /// Distinct positions in ascending order, and for each row the index of its position.
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

    /// For each position, its first known rows, which define the zero of that position.
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

#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalOptions {
    /// Time constants, s; 0 for no lag. Each single time constant and each pair is tried.
    pub lags_s: Vec<f64>,
    /// Penalties of the ridge regression, as fractions of the variance of a feature.
    pub penalties: Vec<f64>,
    /// Whether sensors are removed one after the other, as long as the forward validation does not get worse.
    pub select_sensors: bool,
    /// Number of the best choices that are averaged, because their ranking is partly chance. 0 counts as 1.
    pub mean_of: usize,
}

impl Default for ThermalOptions {
    fn default() -> Self {
        Self {
            lags_s: vec![0.0, 120.0, 300.0, 600.0, 900.0, 1200.0, 1800.0, 2700.0, 3600.0, 5400.0],
            penalties: vec![1e-5, 1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 1e-1],
            select_sensors: false,
            mean_of: 20,
        }
    }
}

impl ThermalOptions {
    /// Ridge regression on temperature differences without lags. The penalty is also chosen by forward validation. It
    /// is the baseline for fits with lags.
    pub fn plain() -> Self {
        Self { lags_s: vec![0.0], mean_of: 1, ..Self::default() }
    }
}

impl ThermalOptions {
    pub(super) fn check(&self) -> Result<(), FitError> {
        let wrong = |what, value, expected| Err(FitError::Parameter { what, value, expected });
        if self.lags_s.is_empty() || self.penalties.is_empty() {
            return wrong("number of lags or penalties", 0.0, "at least one of each");
        }
        if let Some(&lag) = self.lags_s.iter().find(|lag| !(**lag >= 0.0 && lag.is_finite())) {
            return wrong("lag, s", lag, "0 or more");
        }
        match self.penalties.iter().find(|p| !(**p > 0.0 && p.is_finite())) {
            Some(&penalty) => wrong("penalty", penalty, "a positive number"),
            None => Ok(()),
        }
    }
}

pub(super) fn enough_rows(
    record: &ThermalRecord,
    requested: &Range<usize>,
    known: &[usize],
    needed: usize,
) -> Result<(), FitError> {
    if requested.end <= record.len() && known.len() >= needed {
        return Ok(());
    }
    Err(FitError::TooFew {
        what: if known.len() < requested.len().min(record.len()) {
            "rows that are not behind a gap in the log"
        } else {
            "rows"
        },
        purpose: "a thermal fit",
        found: known.len(),
        needed,
    })
}
