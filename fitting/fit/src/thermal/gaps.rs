//! Gaps in the log of a thermal test: what the temperatures did in them is not known, and with a lag it matters for a while.

use std::ops::Range;

use super::record::ThermalRecord;

/// An interval that is so many times the usual one may be a gap.
const LONGER_THAN_USUAL: f64 = 10.0;
/// In less time, s, no temperature of a machine goes far from a straight line.
const LEAST_S: f64 = 120.0;
/// A lag has forgotten a gap where what the temperature was there counts for less than this share.
const FORGOTTEN: f64 = 0.05;

/// A gap in the log of a thermal test.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ThermalGap {
    /// Time of the last row before it, s.
    pub from_s: f64,
    /// Time of the first row behind it, s.
    pub to_s: f64,
    /// The rows behind it that are left out, until every lag has forgotten it: none where no lag sees it.
    pub left_out: Range<usize>,
}

impl ThermalRecord {
    /// The interval between two rows that half of them do not exceed, s; 0 where there is only one row.
    pub fn usual_interval_s(&self) -> f64 {
        let mut steps: Vec<f64> = self.time_s.windows(2).map(|p| p[1] - p[0]).collect();
        steps.sort_by(f64::total_cmp);
        steps.get(steps.len() / 2).copied().unwrap_or(0.0)
    }

    /// The gaps of the log, for terms with these time constants, s.
    ///
    /// A gap is an interval of more than ten times the usual one and more than two minutes. Of what it was in a gap of length g a lag keeps the share 1 − exp(−g/lag), and
    /// of that exp(−t/lag) at a time t behind the gap. The rows until it is less than a twentieth are left out.
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

    /// The rows among `rows` that no gap leaves out for terms with these time constants.
    pub(super) fn known_rows(&self, rows: &Range<usize>, lags_s: &[f64]) -> Vec<usize> {
        let gaps = self.gaps(lags_s);
        let end = rows.end.min(self.len());
        (rows.start.min(end)..end)
            .filter(|row| !gaps.iter().any(|gap| gap.left_out.contains(row)))
            .collect()
    }
}
