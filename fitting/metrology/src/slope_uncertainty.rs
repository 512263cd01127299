//! Measurement uncertainty of the slope of a straight line (type A, JCGM 100), from the slopes of its runs, or from the
//! readings of a single run.

use std::collections::{BTreeMap, BTreeSet};

use crate::{Direction, Measurement, ReferenceLine};

const URAD_PER_UM_PER_MM: f64 = 1e3;

/// Standard uncertainty of a slope, with its degrees of freedom.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct SlopeUncertainty {
    pub standard_urad: f64,
    pub degrees: f64,
}

impl SlopeUncertainty {
    /// Uncertainty of the mean slope of several runs, s/√n from the scatter of their slopes. It includes realignment
    /// and drift of the reference between runs, which the residuals from the mean line do not show. `None` for one run
    /// in each direction.
    ///
    /// Slopes are about the mean profile, so that they contain neither the profile nor the reversal. The slopes of runs
    /// that lack targets are those of their alignment. If runs have separate numbers in the two directions, each
    /// direction has its own mean, and there is one degree of freedom less.
    pub fn of_runs(measurement: &Measurement) -> Option<Self> {
        // Adding 0 turns −0 into 0, which is the same target.
        let key = |target: f64, direction| (direction, (target + 0.0).to_bits());
        if let Some(incomplete) = measurement.incomplete_runs() {
            return incomplete.slope_uncertainty();
        }
        let readings = &measurement.readings;
        let mut means: BTreeMap<(Direction, u64), (f64, f64)> = BTreeMap::new();
        let mut runs_in = [BTreeSet::new(), BTreeSet::new()];
        for reading in readings {
            let (sum, count) = means.entry(key(reading.target, reading.direction)).or_default();
            *sum += reading.deviation;
            *count += 1.0;
            runs_in[reading.direction as usize].insert(reading.run);
        }
        let mut runs: BTreeMap<u32, Vec<(f64, f64)>> = BTreeMap::new();
        for reading in readings {
            let (sum, count) = means[&key(reading.target, reading.direction)];
            let run = runs.entry(reading.run).or_default();
            run.push((reading.target, reading.deviation - sum / count));
        }
        let [forward, backward] = runs_in.each_ref().map(|runs| runs.len() as f64);
        let (n, means) = if runs_in[0].is_disjoint(&runs_in[1]) && forward * backward > 0.0 {
            // The slope is the mean of the slopes of both directions.
            (4.0 / (1.0 / forward + 1.0 / backward), 2.0)
        } else {
            (runs.len() as f64, 1.0)
        };
        let degrees = runs.len() as f64 - means;
        let slopes = runs.values().map(|run| ReferenceLine::least_squares(run));
        let squares = slopes
            .map(|line| line.map(|line| line.slope().0.powi(2)))
            .sum::<Result<f64, _>>()
            .ok()?;
        (degrees > 0.0).then(|| Self { standard_urad: (squares / degrees / n).sqrt(), degrees })
    }

    /// Uncertainty of the least-squares line through a profile of points (target in mm, deviation in µm), from its
    /// residuals: s/√Σ(q − q̄)², where s² is the sum of the squared residuals divided by n − 2. The straightness error
    /// counts as noise. A tilt of the reference is not included. `None` for fewer than three targets.
    pub fn of_line(profile: &[(f64, f64)]) -> Option<Self> {
        let line = ReferenceLine::least_squares(profile).ok()?;
        let targets: Vec<f64> = profile.iter().map(|(target, _)| *target).collect();
        let degrees = profile.len() as f64 - 2.0;
        let squares: f64 = line.removed_from(profile).iter().map(|r| r.1 * r.1).sum();
        (degrees > 0.0).then(|| Self {
            standard_urad: (squares / degrees).sqrt() * slope_gain(&targets),
            degrees,
        })
    }

    /// Uncertainty of the least-squares line through a profile that is summed from bridge tilts (µrad), from the
    /// scatter of the tilts about their mean. The residuals of the profile would give too small a value, because the
    /// errors of the tilts accumulate in the profile. `readings` are points (target in mm, tilt). The tilt at the first
    /// target is not used, as in [`angular_method_um`](crate::angular_method_um). `None` for fewer than two tilts.
    pub fn of_tilts(readings: &[(f64, f64)]) -> Option<Self> {
        let tilts = || readings.iter().skip(1).map(|(_, tilt)| tilt);
        let n = tilts().count() as f64;
        let mean = tilts().sum::<f64>() / n;
        let squares: f64 = tilts().map(|tilt| (tilt - mean).powi(2)).sum();
        (n > 1.0).then(|| Self {
            standard_urad: (squares / (n - 1.0)).sqrt() * slope_gain_of_tilts(tilts().count()),
            degrees: n - 1.0,
        })
    }

    /// Uncertainty of the sum or difference of independent slopes. The degrees of freedom are by Welch and
    /// Satterthwaite (JCGM 100, G.4).
    pub fn of_sum(parts: impl IntoIterator<Item = Self>) -> Self {
        let (mut variance, mut over_degrees) = (0.0, 0.0);
        for part in parts {
            let own = part.standard_urad.powi(2);
            variance += own;
            over_degrees += own * own / part.degrees;
        }
        Self {
            standard_urad: variance.sqrt(),
            degrees: if over_degrees > 0.0 {
                variance * variance / over_degrees
            } else {
                f64::INFINITY
            },
        }
    }

    /// Uncertainty of this slope divided by a number.
    #[must_use]
    pub fn divided_by(self, number: f64) -> Self {
        Self { standard_urad: self.standard_urad / number, ..self }
    }

    /// Expanded uncertainty for 95.45 % (the probability of k = 2) by Student's t, µrad.
    pub fn expanded_urad(&self) -> f64 {
        coverage_factor(self.degrees) * self.standard_urad
    }
}

/// Standard uncertainty of the least-squares slope per standard uncertainty of independent deviations, µrad/µm: 1/√Σ(q
/// − q̄)².
pub fn slope_gain(targets_mm: &[f64]) -> f64 {
    let mean = targets_mm.iter().sum::<f64>() / targets_mm.len() as f64;
    let spread: f64 = targets_mm.iter().map(|q| (q - mean).powi(2)).sum();
    URAD_PER_UM_PER_MM / spread.sqrt()
}

/// Standard uncertainty of the least-squares slope through summed tilts, per standard uncertainty of independent tilts.
/// With M = n + 1 equidistant points the slope is the mean of the n tilts, weighted by 6 k (M − k)/(M (M² − 1)). The
/// result is the root of the sum of the squared weights.
pub fn slope_gain_of_tilts(tilts: usize) -> f64 {
    let points = tilts as f64 + 1.0;
    let square = points * points;
    (6.0 * (square + 1.0) / (5.0 * points * (square - 1.0))).sqrt()
}

/// Degrees of freedom and t for 95.45 % (two sides) (JCGM 100, table G.2, with more digits).
const TABLE: [(f64, f64); 22] = [
    (1.0, 13.967_73),
    (1.12, 10.776_644),
    (1.25, 8.665_154),
    (1.375, 7.341_358),
    (1.5, 6.418_19),
    (1.75, 5.236_653),
    (2.0, 4.526_537),
    (2.25, 4.059_534),
    (2.5, 3.731_988),
    (3.0, 3.306_822),
    (3.5, 3.045_304),
    (4.0, 2.869_309),
    (5.0, 2.648_649),
    (6.0, 2.516_524),
    (8.0, 2.366_416),
    (10.0, 2.283_678),
    (15.0, 2.181_163),
    (20.0, 2.133_025),
    (30.0, 2.086_844),
    (60.0, 2.042_531),
    (120.0, 2.021_048),
    (f64::INFINITY, 2.0),
];

/// Coverage factor for 95.45 %. Its logarithm is interpolated over 1/ν in the table. Below one degree of freedom the
/// value for one is returned.
fn coverage_factor(degrees: f64) -> f64 {
    let at = 1.0 / degrees.max(1.0);
    let above = TABLE.partition_point(|(degrees, _)| 1.0 / degrees > at);
    let (narrow_at, narrow) = TABLE[above];
    let (wide_at, wide) = TABLE[above.saturating_sub(1)];
    let [from, to] = [wide_at, narrow_at].map(|degrees| 1.0 / degrees);
    let share = if from > to { (at - to) / (from - to) } else { 0.0 };
    (narrow.ln() + share * (wide.ln() - narrow.ln())).exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Values of table G.2 of JCGM 100 for 95.45 %. Only the first two and the last are also nodes of `TABLE`.
    #[test]
    fn factors_are_those_of_the_guide() {
        for (degrees, t) in [
            (1.0, 13.97),
            (2.0, 4.53),
            (7.0, 2.43),
            (9.0, 2.32),
            (12.0, 2.23),
            (17.0, 2.16),
            (25.0, 2.11),
            (45.0, 2.06),
            (100.0, 2.025),
            (f64::INFINITY, 2.0),
        ] {
            let found = coverage_factor(degrees);
            assert!((found - t).abs() < 0.006, "{degrees}: {found} {t}");
        }
        assert_eq!(coverage_factor(0.3), coverage_factor(1.0));
        // The factor decreases monotonically between the nodes.
        let all: Vec<f64> = (0..400).map(|k| coverage_factor(1.0 + 0.1 * f64::from(k))).collect();
        assert!(all.windows(2).all(|pair| pair[1] < pair[0]));
    }

    /// Compares the gains with the slopes of lines through a unit deviation of each single target or tilt.
    #[test]
    fn gains_are_those_of_the_least_squares_line() {
        let slope = |profile: &[(f64, f64)]| {
            let line = ReferenceLine::least_squares(profile);
            line.expect("two targets").slope().0
        };
        let targets = [0.0, 100.0, 250.0, 300.0];
        let single = |own: usize| {
            let at = |place: usize| (targets[place], f64::from(u8::from(place == own)));
            slope(&[0, 1, 2, 3].map(at)).powi(2)
        };
        let expected = (0..4).map(single).sum::<f64>().sqrt();
        assert!((slope_gain(&targets) - expected).abs() < 1e-9);
        for tilts in [1_usize, 2, 3, 10] {
            // A tilt of 1 µrad on a foot spacing of 1000 mm raises all following points by 1 µm.
            let single = |own: usize| {
                let at = |place: usize| (1e3 * place as f64, f64::from(u8::from(place >= own)));
                slope(&(0..=tilts).map(at).collect::<Vec<_>>()).powi(2)
            };
            let expected = (1..=tilts).map(single).sum::<f64>().sqrt();
            assert!((slope_gain_of_tilts(tilts) - expected).abs() < 1e-9, "{tilts}");
        }
    }
}
