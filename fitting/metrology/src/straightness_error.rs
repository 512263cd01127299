//! The straightness of a motion from its readings: the same profile about each of the reference lines of ISO 230-1.

use std::collections::BTreeMap;

use crate::number::range;
use crate::{Direction, Measurement, MetrologyError, ReferenceKind, ReferenceLine};

/// The straightness error about one reference line.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct StraightnessAbout {
    /// How the line was laid.
    pub kind: ReferenceKind,
    /// The line.
    pub line: ReferenceLine,
    /// Straightness error: the range of the profile about the line, µm.
    pub error_um: f64,
}

/// The straightness of a motion.
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct Straightness {
    /// Targets, mm, and the mean deviation of all runs, µm, before any line is removed.
    pub profile: Vec<(f64, f64)>,
    /// About the line of least squares, the one through the end points, and the middle of the minimum zone.
    pub about: [StraightnessAbout; 3],
    /// The largest difference of the means of the two directions, µm; `None` with one direction.
    pub reversal_um: Option<f64>,
    /// Standard uncertainty of the slope of least squares by the residuals alone, µrad; `None` with two targets. Straightness itself
    /// counts as noise in it.
    pub slope_standard_uncertainty_urad: Option<f64>,
}

impl Straightness {
    /// The straightness about a line of this kind.
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

/// The standard uncertainty of the slope of a line, µrad: what its readings leave (`of_line`), or that of the slopes of its runs, where these scatter for
/// themselves, as of a beam that is aligned anew.
pub fn slope_uncertainty_with_runs(measurement: &Measurement, of_line: Option<f64>) -> Option<f64> {
    let of_runs = slope_uncertainty_of_runs(measurement);
    match (of_runs, of_line) {
        (Some(of_runs), Some(of_line)) if of_runs <= TIMES_OF_LINE * of_line => Some(of_line),
        (of_runs, of_line) => of_runs.or(of_line),
    }
}

/// The slopes of runs scatter for themselves where their mean is uncertain by more than so many times what its line leaves: readings that scatter
/// independently do that to one line in twenty of two runs, and to fewer of more.
const TIMES_OF_LINE: f64 = 2.0;

/// s/√n in µrad with s the standard deviation of the slopes of n runs, both directions of one together; `None` of fewer than two.
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
