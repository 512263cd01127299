//! Straightness: profiles from bridge readings, reference lines of ISO 230-1, and the straightness error about each of them.

use volcomp_vocabulary::{AxisName, ErrorName, Urad};

use crate::number::range;
use crate::{Direction, Measurement, MetrologyError, MotionKind, Quantity, SlopeUncertainty};

/// Sign convention of the tilt reading of a bridge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum TiltReading {
    /// Right-hand sign of the angular error `E?N` about its axis.
    RightHand,
    /// Slope of the profile: positive if the deviation increases along the axis.
    Slope,
}

/// Sign σ that converts a tilt reading to the slope of a straightness error: +1 for EYX, EZY, EXZ and −1 for EZX, EXY, EYZ with right-hand readings,
/// +1 with slopes.
///
/// # Errors
/// `error` is not one of these six.
pub fn tilt_sign(error: ErrorName, reading: TiltReading) -> Result<f64, MetrologyError> {
    let primary = matches!(error.axis, AxisName::X | AxisName::Y | AxisName::Z);
    if error.location || !primary || MotionKind::of(error) != MotionKind::Straightness {
        return Err(MetrologyError::ErrorName {
            what: "straightness by the angular method".into(),
            found: error.to_string(),
            expected: "EYX, EZX, EXY, EZY, EXZ or EYZ".into(),
        });
    }
    // Rotation about the third axis raises the profile if axis, deviation and third axis are in cyclic order like X, Y, Z.
    let follows = (error.axis.mcs_index() + 1) % 3 == error.component.mcs_index();
    Ok(match reading {
        TiltReading::RightHand if !follows => -1.0,
        _ => 1.0,
    })
}

/// Straightness profile from the tilts of a bridge that is moved in steps of its length.
///
/// `tilts` are (target in mm, θ_k in µrad), targets ascending; θ_k is read with the feet on targets k − 1 and k, the first reading is not used.
/// `bridge_mm` is the foot spacing s. Returns (target in mm, h_k in µm) with h_0 = 0 and h_k = h_{k−1} + s σ θ_k, before any reference line is
/// removed.
///
/// # Errors
/// Not a straightness error, fewer than two targets, numbers that are not finite, or a target spacing that differs from `bridge_mm` by more than 1 %.
pub fn angular_method_um(
    error: ErrorName,
    reading: TiltReading,
    tilts: &[(f64, f64)],
    bridge_mm: f64,
) -> Result<Vec<(f64, f64)>, MetrologyError> {
    const UM_PER_MM_URAD: f64 = 1e-3;
    const SPACING_TOLERANCE: f64 = 0.01;
    let sign = tilt_sign(error, reading)?;
    check_points("straightness by the angular method", tilts)?;
    check_bridge(bridge_mm)?;
    let mut h_um = 0.0;
    let mut profile = vec![(tilts[0].0, h_um)];
    for pair in tilts.windows(2) {
        let [(from, _), (to, tilt_urad)] = [pair[0], pair[1]];
        let found = to - from;
        if (found - bridge_mm).abs() > SPACING_TOLERANCE * bridge_mm {
            return Err(MetrologyError::BridgeSpacing {
                from,
                to,
                found,
                bridge_mm,
            });
        }
        h_um += bridge_mm * sign * tilt_urad * UM_PER_MM_URAD;
        profile.push((to, h_um));
    }
    Ok(profile)
}

/// Definition of the reference line of a straightness profile (ISO 230-1 names all three).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ReferenceKind {
    /// Least squares of the deviations.
    #[default]
    LeastSquares,
    /// Through the first and the last target.
    EndPoints,
    /// Middle of the narrowest strip that encloses all points.
    MinimumZone,
}

/// Straight line through a profile: removed before straightness is evaluated, and the basis of squareness.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ReferenceLine {
    /// Slope in µm/mm; [`slope`](Self::slope) gives it as an angle in µrad (= µm/m).
    pub slope_um_per_mm: f64,
    /// Value at coordinate 0, µm.
    pub intercept_um: f64,
}

impl ReferenceLine {
    /// Ordinary least squares through (target in mm, value in µm), each target once.
    ///
    /// # Errors
    /// Fewer than two different targets, or numbers that are not finite.
    pub fn least_squares(points: &[(f64, f64)]) -> Result<Self, MetrologyError> {
        check_points("least-squares reference line", points)?;
        let n = points.len() as f64;
        let mean_target = points.iter().map(|(q, _)| q).sum::<f64>() / n;
        let mean_value = points.iter().map(|(_, x)| x).sum::<f64>() / n;
        let about_mean = || {
            points
                .iter()
                .map(|(q, x)| (q - mean_target, x - mean_value))
        };
        let variance: f64 = about_mean().map(|(q, _)| q * q).sum();
        let covariance: f64 = about_mean().map(|(q, x)| q * x).sum();
        Ok(Self::through(
            mean_target,
            mean_value,
            covariance / variance,
        ))
    }

    /// Line through the values at the smallest and the largest target.
    ///
    /// # Errors
    /// Fewer than two different targets, or numbers that are not finite.
    pub fn end_points(points: &[(f64, f64)]) -> Result<Self, MetrologyError> {
        check_points("end-point reference line", points)?;
        let by_target = |a: &&(f64, f64), b: &&(f64, f64)| a.0.total_cmp(&b.0);
        let (first, last) = (
            points.iter().min_by(by_target),
            points.iter().max_by(by_target),
        );
        let ((q_0, x_0), (q_1, x_1)) = (
            first.copied().unwrap_or_default(),
            last.copied().unwrap_or_default(),
        );
        Ok(Self::through(q_0, x_0, (x_1 - x_0) / (q_1 - q_0)))
    }

    /// Middle of the narrowest strip, measured in the direction of the deviations, between two parallel lines that enclose all points. Exact: one
    /// side of the strip lies on an edge of their convex hull.
    ///
    /// # Errors
    /// Fewer than two different targets, or numbers that are not finite.
    pub fn minimum_zone(points: &[(f64, f64)]) -> Result<Self, MetrologyError> {
        check_points("minimum-zone reference line", points)?;
        let mut sorted = points.to_vec();
        sorted.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let lower = half_hull(sorted.iter().copied());
        let upper = half_hull(sorted.iter().map(|(q, x)| (*q, -x)));
        let below = |slope: f64| {
            let heights = lower.iter().map(|(q, x)| x - slope * q);
            heights.fold(f64::INFINITY, f64::min)
        };
        let above = |slope: f64| {
            let heights = upper.iter().map(|(q, x)| -x - slope * q);
            heights.fold(f64::NEG_INFINITY, f64::max)
        };
        // The width is a convex function of the slope with kinks only where a side lies on an edge.
        let edges = |hull: &[(f64, f64)], sign: f64| -> Vec<f64> {
            let edges = hull.windows(2).filter(|edge| edge[1].0 > edge[0].0);
            let slope =
                |edge: &[(f64, f64)]| sign * (edge[1].1 - edge[0].1) / (edge[1].0 - edge[0].0);
            edges.map(slope).collect()
        };
        let mut slopes = edges(&lower, 1.0);
        slopes.extend(edges(&upper, -1.0));
        let width = |slope: &f64| above(*slope) - below(*slope);
        let best = slopes
            .into_iter()
            .min_by(|a, b| width(a).total_cmp(&width(b)));
        // Two different targets make at least one edge.
        let slope = best.unwrap_or_default();
        Ok(Self {
            slope_um_per_mm: slope,
            intercept_um: 0.5 * (above(slope) + below(slope)),
        })
    }

    /// Line of this kind.
    ///
    /// # Errors
    /// Fewer than two different targets, or numbers that are not finite.
    pub fn of(kind: ReferenceKind, points: &[(f64, f64)]) -> Result<Self, MetrologyError> {
        match kind {
            ReferenceKind::LeastSquares => Self::least_squares(points),
            ReferenceKind::EndPoints => Self::end_points(points),
            ReferenceKind::MinimumZone => Self::minimum_zone(points),
        }
    }

    fn through(target_mm: f64, value_um: f64, slope_um_per_mm: f64) -> Self {
        Self {
            slope_um_per_mm,
            intercept_um: value_um - slope_um_per_mm * target_mm,
        }
    }

    /// Slope as an angle, the unit of squareness: 1 µm/mm = 1000 µrad.
    pub fn slope(&self) -> Urad {
        const URAD_PER_UM_PER_MM: f64 = 1000.0;
        Urad(self.slope_um_per_mm * URAD_PER_UM_PER_MM)
    }

    /// Value of the line at a coordinate in mm, µm.
    pub fn value_um(&self, target_mm: f64) -> f64 {
        self.intercept_um + self.slope_um_per_mm * target_mm
    }

    /// Profile after removing the line: (target in mm, deviation in µm).
    pub fn removed_from(&self, points: &[(f64, f64)]) -> Vec<(f64, f64)> {
        points
            .iter()
            .map(|(q, x)| (*q, x - self.value_um(*q)))
            .collect()
    }
}

/// Lower half of the convex hull of points in ascending order (Andrew's monotone chain).
pub(crate) fn half_hull(points: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut hull: Vec<(f64, f64)> = Vec::new();
    for point in points {
        while let [.., a, b] = hull[..] {
            let turn = (b.0 - a.0) * (point.1 - a.1) - (b.1 - a.1) * (point.0 - a.0);
            if turn > 0.0 {
                break;
            }
            hull.pop();
        }
        // Of several values at the first target the lowest is already in the hull.
        if hull
            .last()
            .is_none_or(|last| last.0 < point.0 || last.1 > point.1)
        {
            hull.push(point);
        }
    }
    hull
}

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
    /// Uncertainty of the least-squares slope: of the runs, or with one run of the readings about the line; `None` with one run of two targets.
    pub slope_uncertainty: Option<SlopeUncertainty>,
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

/// Evaluates the profile of all runs of a measurement with deviations in µm. If not all runs hold all targets, they are aligned by offset and slope.
///
/// # Errors
/// Fewer than two targets, numbers that are not finite, a target lacking in a direction that was run, runs that cannot be aligned.
pub fn straightness_of(measurement: &Measurement) -> Result<Straightness, MetrologyError> {
    let measurement = &Measurement {
        quantity: Some(Quantity::Straightness),
        ..measurement.clone()
    };
    measurement.check_directions()?;
    measurement.check_lines_of_runs()?;
    let mut straightness = straightness_of_profile(&measurement.mean_curve())?;
    let [forward, backward] = Direction::BOTH.map(|d| measurement.mean_curve_in(d));
    let of_runs = SlopeUncertainty::of_runs(measurement);
    straightness.slope_uncertainty = of_runs.or(straightness.slope_uncertainty);
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
        slope_uncertainty: SlopeUncertainty::of_line(profile),
        profile: profile.to_vec(),
        about,
        reversal_um: None,
    })
}

fn check_points(name: &str, points: &[(f64, f64)]) -> Result<(), MetrologyError> {
    let refuse = |found: String, expected: &str| {
        Err(MetrologyError::readings(name, "points", found, expected))
    };
    let unsound = |(q, x): &&(f64, f64)| !q.is_finite() || !x.is_finite();
    if let Some((q, x)) = points.iter().find(unsound) {
        return refuse(format!("{x} at target {q}"), "finite numbers");
    }
    if points.iter().all(|(q, _)| *q == points[0].0) {
        let found = points.len().to_string();
        return refuse(found, "at least two different targets");
    }
    Ok(())
}

fn check_bridge(bridge_mm: f64) -> Result<(), MetrologyError> {
    if bridge_mm.is_finite() && bridge_mm > 0.0 {
        return Ok(());
    }
    Err(MetrologyError::readings(
        "straightness by the angular method",
        "bridge length",
        format!("{bridge_mm} mm"),
        "a positive length",
    ))
}
