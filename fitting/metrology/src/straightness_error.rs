//! Straightness of a motion from its readings: the same profile about each of the reference lines of ISO 230-1.

use std::collections::BTreeMap;

use crate::number::range;
use crate::{Direction, Measurement, MetrologyError, ReferenceKind, ReferenceLine};

/// Straightness error about one reference line.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct StraightnessAbout {
    /// Definition of the line.
    pub kind: ReferenceKind,
    /// The reference line.
    pub line: ReferenceLine,
    /// Straightness error: the range of the profile about the line, µm.
    pub error_um: f64,
}

/// Straightness of a motion.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Straightness {
    /// Targets, mm, and the mean deviation of all runs, µm, before any line is removed.
    pub profile: Vec<(f64, f64)>,
    /// About the least-squares line, the end-point line, and the middle of the minimum zone.
    pub about: [StraightnessAbout; 3],
    /// Largest difference of the means of the two directions, µm; `None` with one direction.
    pub reversal_um: Option<f64>,
    /// Standard uncertainty of the least-squares slope from the residuals alone, µrad; `None` with two targets. The straightness error itself counts
    /// as noise.
    pub slope_standard_uncertainty_urad: Option<f64>,
}

impl Straightness {
    /// Straightness about a line of this kind.
    pub fn of(&self, kind: ReferenceKind) -> &StraightnessAbout {
        match kind {
            ReferenceKind::LeastSquares => &self.about[0],
            ReferenceKind::EndPoints => &self.about[1],
            ReferenceKind::MinimumZone => &self.about[2],
        }
    }
}

/// Evaluates the profile of all runs of a measurement with deviations in µm.
///
/// # Errors
/// Fewer than two targets, numbers that are not finite, a target lacking in a direction that was run.
pub fn straightness_of(measurement: &Measurement) -> Result<Straightness, MetrologyError> {
    measurement.check_directions()?;
    let mut straightness = straightness_of_profile(&measurement.mean_curve())?;
    let [forward, backward] = Direction::BOTH.map(|d| measurement.mean_curve_in(d));
    let of_line = straightness.slope_standard_uncertainty_urad;
    straightness.slope_standard_uncertainty_urad =
        slope_uncertainty_with_runs(measurement, of_line);
    straightness.reversal_um = if backward.is_empty() || forward.is_empty() {
        None
    } else {
        let differences = forward
            .iter()
            .zip(&backward)
            .map(|(a, b)| (a.1 - b.1).abs());
        differences.reduce(f64::max)
    };
    Ok(straightness)
}

/// Evaluates a profile of (target in mm, deviation in µm), targets ascending.
///
/// # Errors
/// Fewer than two targets, numbers that are not finite.
pub fn straightness_of_profile(profile: &[(f64, f64)]) -> Result<Straightness, MetrologyError> {
    let about = |kind: ReferenceKind| -> Result<StraightnessAbout, MetrologyError> {
        let line = ReferenceLine::of(kind, profile)?;
        let residuals = line.removed_from(profile);
        let [lowest, highest] = range(residuals.iter().map(|r| r.1));
        Ok(StraightnessAbout {
            kind,
            line,
            error_um: highest - lowest,
        })
    };
    let about = [
        about(ReferenceKind::LeastSquares)?,
        about(ReferenceKind::EndPoints)?,
        about(ReferenceKind::MinimumZone)?,
    ];
    Ok(Straightness {
        slope_standard_uncertainty_urad: slope_uncertainty(profile, &about[0].line),
        profile: profile.to_vec(),
        about,
        reversal_um: None,
    })
}

/// Standard uncertainty of the slope of a line, µrad: from its residuals (`of_line`), or from the slopes of its runs if these scatter more than the
/// residuals explain, as with a beam that is realigned for each run.
pub fn slope_uncertainty_with_runs(measurement: &Measurement, of_line: Option<f64>) -> Option<f64> {
    let of_runs = slope_uncertainty_of_runs(measurement);
    match (of_runs, of_line) {
        (Some(of_runs), Some(of_line)) if of_runs <= TIMES_OF_LINE * of_line => Some(of_line),
        (of_runs, of_line) => of_runs.or(of_line),
    }
}

/// Ratio of both uncertainties above which the slopes of the runs scatter more than the residuals of the line explain. Independent scatter of the
/// readings exceeds it for one in twenty lines of two runs, and more rarely with more runs.
const TIMES_OF_LINE: f64 = 2.0;

/// s/√n in µrad with s the standard deviation of the slopes of n runs, both directions of a run together; `None` for fewer than two.
fn slope_uncertainty_of_runs(measurement: &Measurement) -> Option<f64> {
    let mut runs: BTreeMap<u32, Vec<(f64, f64)>> = BTreeMap::new();
    for reading in &measurement.readings {
        let run = runs.entry(reading.run).or_default();
        run.push((reading.target, reading.deviation));
    }
    let lines = runs
        .values()
        .filter_map(|run| ReferenceLine::least_squares(run).ok());
    let slopes: Vec<f64> = lines.map(|line| line.slope().0).collect();
    let n = slopes.len() as f64;
    let mean = slopes.iter().sum::<f64>() / n;
    let squares: f64 = slopes.iter().map(|slope| (slope - mean).powi(2)).sum();
    (slopes.len() > 1).then(|| (squares / (n - 1.0) / n).sqrt())
}

/// s/√Σ(q − q̄)² with s² the sum of the squared residuals over n − 2.
fn slope_uncertainty(profile: &[(f64, f64)], line: &ReferenceLine) -> Option<f64> {
    const URAD_PER_UM_PER_MM: f64 = 1e3;
    let n = profile.len();
    if n < 3 {
        return None;
    }
    let squares: f64 = line.removed_from(profile).iter().map(|r| r.1 * r.1).sum();
    let mean = profile.iter().map(|p| p.0).sum::<f64>() / n as f64;
    let spread: f64 = profile.iter().map(|p| (p.0 - mean).powi(2)).sum();
    Some((squares / (n - 2) as f64 / spread).sqrt() * URAD_PER_UM_PER_MM)
}
