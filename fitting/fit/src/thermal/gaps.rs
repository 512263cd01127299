//! Gaps in the log of a thermal test. The temperatures in a gap are unknown, and with a lag they matter for some time after it.

use std::ops::Range;

use super::record::ThermalRecord;

/// An interval longer than this multiple of the usual one may be a gap.
const LONGER_THAN_USUAL: f64 = 10.0;
/// Minimum length of a gap, s: in less time no temperature of a machine departs far from a straight line.
const LEAST_S: f64 = 120.0;
/// Weight of the temperature in a gap below which a lag no longer depends on it.
const FORGOTTEN: f64 = 0.05;

/// A gap in the log of a thermal test.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalGap {
    /// Time of the last row before it, s.
    pub from_s: f64,
    /// Time of the first row after it, s.
    pub to_s: f64,
    /// Rows excluded after it, until no lag depends on the gap any more; empty if there is no lag.
    pub left_out: Range<usize>,
}

impl ThermalRecord {
    /// Median interval between rows, s; 0 for a single row.
    pub fn usual_interval_s(&self) -> f64 {
        let mut steps: Vec<f64> = self.time_s.windows(2).map(|p| p[1] - p[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied().unwrap_or(0.0)
    }

    /// Gaps of the log, for terms with these time constants, s.
    ///
    /// A gap is an interval of more than ten times the usual one and more than two minutes. After a gap of length g a lag depends on the temperature
    /// in the gap with a weight of 1 − exp(−g/lag), which decays by exp(−t/lag) with the time t after the gap. Rows are excluded until the weight is
    /// below a twentieth.
    pub fn gaps(&self, lags_s: &[f64]) -> Vec<ThermalGap> {
        let lags = || lags_s.iter().copied().filter(|lag| *lag > 0.0);
        let least_s = LEAST_S.max(LONGER_THAN_USUAL * self.usual_interval_s());
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

    /// Those of `rows` that no gap excludes for terms with these time constants.
    pub(super) fn known_rows(&self, rows: &Range<usize>, lags_s: &[f64]) -> Vec<usize> {
        let gaps = self.gaps(lags_s);
        let end = rows.end.min(self.len());
        (rows.start.min(end)..end)
            .filter(|row| !gaps.iter().any(|gap| gap.left_out.contains(row)))
            .collect()
    }
}
