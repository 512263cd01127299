//! Straightness of an axis, and squareness of two linear axes, with their measurement uncertainty.
//!
//! Profiles are computed from bridge readings. The reference lines are those of ISO 230-1. The uncertainty of slopes
//! and squareness follows JCGM 100.

use std::collections::{BTreeMap, BTreeSet};

use volcomp_vocabulary::{AxisName, Component, ErrorName, Urad};

use crate::text::range;
use crate::{Direction, Measurement, MetrologyError, MotionKind, Quantity};

/// Sign convention of bridge tilt readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub enum TiltReading {
    /// A reading is positive by the right-hand rule of the angular error `E?N` about its axis.
    RightHand,
    /// A reading is the slope of the profile, positive if the deviation increases along the axis.
    Slope,
}

/// Sign σ that converts a tilt reading to the slope of a straightness error. With right-hand readings it is +1 for EYX,
/// EZY, EXZ and −1 for EZX, EXY, EYZ. With slopes it is +1.
///
/// # Errors
/// `error` is not one of these six errors.
pub fn tilt_sign(error: ErrorName, reading: TiltReading) -> Result<f64, MetrologyError> {
    let primary = matches!(error.axis, AxisName::X | AxisName::Y | AxisName::Z);
    if error.location || !primary || MotionKind::of(error) != MotionKind::Straightness {
        return Err(MetrologyError::ErrorName {
            what: "straightness by the angular method".into(),
            found: error.to_string(),
            expected: "EYX, EZX, EXY, EZY, EXZ or EYZ".into(),
        });
    }
    // A rotation about the third axis raises the profile if axis, deviation and third axis are in cyclic order, like X,
    // Y, Z.
    let follows = (error.axis.mcs_index() + 1) % 3 == error.component.mcs_index();
    Ok(match reading {
        TiltReading::RightHand if !follows => -1.0,
        _ => 1.0,
    })
}

/// Straightness profile from the tilts of a bridge that is moved in steps of its length.
///
/// `tilts` are (target in mm, θ_k in µrad) with ascending targets. θ_k is read with the feet on targets k − 1 and k, so
/// the first reading is unused. `bridge_mm` is the foot spacing s. Returns (target in mm, h_k in µm) with h_0 = 0 and
/// h_k = h_{k−1} + s σ θ_k, where σ is [`tilt_sign`]. No reference line is removed.
///
/// # Errors
/// `error` is not a straightness error, there are fewer than two targets, a number is not finite, or a target spacing
/// differs from `bridge_mm` by more than 1 %.
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
            return Err(MetrologyError::BridgeSpacing { from, to, found, bridge_mm });
        }
        h_um += bridge_mm * sign * tilt_urad * UM_PER_MM_URAD;
        profile.push((to, h_um));
    }
    Ok(profile)
}

#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct StraightnessAbout {
    pub kind: ReferenceKind,
    pub line: ReferenceLine,
    /// Straightness error, µm: the range of the profile about the line.
    pub error_um: f64,
}

#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Straightness {
    /// Targets, mm, with the mean deviation of all runs, µm. No reference line is removed.
    pub profile: Vec<(f64, f64)>,
    /// Straightness about the least-squares line, the end-point line, and the middle line of the minimum zone, in this
    /// order.
    pub about: [StraightnessAbout; 3],
    /// Largest difference between the means of the two directions, µm; `None` if only one direction was measured.
    pub reversal_um: Option<f64>,
    /// Uncertainty of the least-squares slope, from several runs, or from the residuals of a single run; `None` for one
    /// run with two targets.
    pub slope_uncertainty: Option<SlopeUncertainty>,
}

impl Straightness {
    /// Straightness about the reference line of this kind.
    pub fn of(&self, kind: ReferenceKind) -> &StraightnessAbout {
        match kind {
            ReferenceKind::LeastSquares => &self.about[0],
            ReferenceKind::EndPoints => &self.about[1],
            ReferenceKind::MinimumZone => &self.about[2],
        }
    }
}

/// Evaluates the profile of all runs of a measurement with deviations in µm. If some runs lack targets, the runs are
/// aligned by offset and slope.
///
/// # Errors
///
/// Fewer than two targets, numbers that are not finite, a target that lacks readings in a direction that was measured,
/// or runs that cannot be aligned.
pub fn straightness_of(measurement: &Measurement) -> Result<Straightness, MetrologyError> {
    let measurement =
        &Measurement { quantity: Some(Quantity::Straightness), ..measurement.clone() };
    measurement.check_directions()?;
    measurement.check_lines_of_runs()?;
    let mut straightness = straightness_of_profile(&measurement.mean_curve())?;
    let [forward, backward] = Direction::BOTH.map(|d| measurement.mean_curve_in(d));
    let of_runs = SlopeUncertainty::of_runs(measurement);
    straightness.slope_uncertainty = of_runs.or(straightness.slope_uncertainty);
    straightness.reversal_um = if backward.is_empty() || forward.is_empty() {
        None
    } else {
        let differences = forward.iter().zip(&backward).map(|(a, b)| (a.1 - b.1).abs());
        differences.reduce(f64::max)
    };
    Ok(straightness)
}

/// Evaluates a profile of points (target in mm, deviation in µm) with ascending targets.
///
/// # Errors
/// Fewer than two targets, or numbers that are not finite.
pub fn straightness_of_profile(profile: &[(f64, f64)]) -> Result<Straightness, MetrologyError> {
    let about = |kind: ReferenceKind| -> Result<StraightnessAbout, MetrologyError> {
        let line = ReferenceLine::of(kind, profile)?;
        let residuals = line.removed_from(profile);
        let [lowest, highest] = range(residuals.iter().map(|r| r.1));
        Ok(StraightnessAbout { kind, line, error_um: highest - lowest })
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

/// Definition of the reference line of a straightness profile. ISO 230-1 names all three.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum ReferenceKind {
    /// Least-squares line of the deviations.
    #[default]
    LeastSquares,
    /// Line through the first and the last target.
    EndPoints,
    /// Middle line of the narrowest strip that encloses all points.
    MinimumZone,
}

/// Straight reference line of a profile. It is removed before straightness is evaluated, and its slope is the basis of
/// squareness.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ReferenceLine {
    /// Slope in µm/mm. [`slope`](Self::slope) returns it as an angle in µrad (= µm/m).
    pub slope_um_per_mm: f64,
    /// Value at coordinate 0, µm.
    pub intercept_um: f64,
}

impl ReferenceLine {
    /// Least-squares line through points (target in mm, value in µm). Each target must occur once.
    ///
    /// # Errors
    /// Fewer than two distinct targets, or numbers that are not finite.
    pub fn least_squares(points: &[(f64, f64)]) -> Result<Self, MetrologyError> {
        check_points("least-squares reference line", points)?;
        let n = points.len() as f64;
        let mean_target = points.iter().map(|(q, _)| q).sum::<f64>() / n;
        let mean_value = points.iter().map(|(_, x)| x).sum::<f64>() / n;
        let about_mean = || points.iter().map(|(q, x)| (q - mean_target, x - mean_value));
        let variance: f64 = about_mean().map(|(q, _)| q * q).sum();
        let covariance: f64 = about_mean().map(|(q, x)| q * x).sum();
        Ok(Self::through(mean_target, mean_value, covariance / variance))
    }

    /// Line through the values at the smallest and the largest target.
    ///
    /// # Errors
    /// Fewer than two distinct targets, or numbers that are not finite.
    pub fn end_points(points: &[(f64, f64)]) -> Result<Self, MetrologyError> {
        check_points("end-point reference line", points)?;
        let by_target = |a: &&(f64, f64), b: &&(f64, f64)| a.0.total_cmp(&b.0);
        let (first, last) = (points.iter().min_by(by_target), points.iter().max_by(by_target));
        let ((q_0, x_0), (q_1, x_1)) =
            (first.copied().unwrap_or_default(), last.copied().unwrap_or_default());
        Ok(Self::through(q_0, x_0, (x_1 - x_0) / (q_1 - q_0)))
    }

    /// Middle line of the narrowest strip between two parallel lines that encloses all points. The width of the strip
    /// is measured in the direction of the deviations. The result is exact, because one side of the strip contains an
    /// edge of the convex hull.
    ///
    /// # Errors
    /// Fewer than two distinct targets, or numbers that are not finite.
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
        // The width is a convex function of the slope. It has kinks only if a side of the strip contains an edge.
        let edges = |hull: &[(f64, f64)], sign: f64| -> Vec<f64> {
            let edges = hull.windows(2).filter(|edge| edge[1].0 > edge[0].0);
            let slope =
                |edge: &[(f64, f64)]| sign * (edge[1].1 - edge[0].1) / (edge[1].0 - edge[0].0);
            edges.map(slope).collect()
        };
        let mut slopes = edges(&lower, 1.0);
        slopes.extend(edges(&upper, -1.0));
        let width = |slope: &f64| above(*slope) - below(*slope);
        let best = slopes.into_iter().min_by(|a, b| width(a).total_cmp(&width(b)));
        // Two distinct targets give at least one edge.
        let slope = best.unwrap_or_default();
        Ok(Self { slope_um_per_mm: slope, intercept_um: 0.5 * (above(slope) + below(slope)) })
    }

    /// # Errors
    /// Fewer than two distinct targets, or numbers that are not finite.
    pub fn of(kind: ReferenceKind, points: &[(f64, f64)]) -> Result<Self, MetrologyError> {
        match kind {
            ReferenceKind::LeastSquares => Self::least_squares(points),
            ReferenceKind::EndPoints => Self::end_points(points),
            ReferenceKind::MinimumZone => Self::minimum_zone(points),
        }
    }

    fn through(target_mm: f64, value_um: f64, slope_um_per_mm: f64) -> Self {
        Self { slope_um_per_mm, intercept_um: value_um - slope_um_per_mm * target_mm }
    }

    /// Slope as an angle, which is the unit of squareness: 1 µm/mm = 1000 µrad.
    pub fn slope(&self) -> Urad {
        const URAD_PER_UM_PER_MM: f64 = 1000.0;
        Urad(self.slope_um_per_mm * URAD_PER_UM_PER_MM)
    }

    /// Value of the line at a coordinate, µm.
    pub fn value_um(&self, target_mm: f64) -> f64 {
        self.intercept_um + self.slope_um_per_mm * target_mm
    }

    /// Profile minus the line, as points (target in mm, deviation in µm).
    pub fn removed_from(&self, points: &[(f64, f64)]) -> Vec<(f64, f64)> {
        points.iter().map(|(q, x)| (*q, x - self.value_um(*q))).collect()
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
        // If the first target has several values, the lowest is already in the hull.
        if hull.last().is_none_or(|last| last.0 < point.0 || last.1 > point.1) {
            hull.push(point);
        }
    }
    hull
}

/// Checks that all numbers are finite, and that the points are at more than one target.
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

const URAD_PER_UM_PER_MM: f64 = 1e3;

/// Standard uncertainty of a slope, with its degrees of freedom.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
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

const KNOWN: &str = "EC0Y, EA0Z or EB0Z";

/// Effect of a tilt of a linear axis on an angle between two axes. The angle is between the + direction of the tilted
/// axis and the + direction of the axis that is perpendicular to it and to the axis of rotation. Returns 1 if a
/// positive tilt (right-hand rule) opens the angle, −1 if it closes the angle. `None` for errors that are not a tilt of
/// X, Y or Z, and for the roll of an axis about itself, which changes no such angle.
pub fn opening(error: ErrorName) -> Option<f64> {
    let linear = matches!(error.axis, AxisName::X | AxisName::Y | AxisName::Z);
    let (own, about) = (error.axis.mcs_index(), error.component.mcs_index());
    if !(error.location && linear && error.component.is_angular()) || own == about {
        return None;
    }
    // A positive rotation turns X to Y about Z, Y to Z about X, and Z to X about Y. So it opens the angle if the tilted
    // axis is the second of these pairs.
    let turns_away = (about + 2) % 3 == own;
    Some(if turns_away { 1.0 } else { -1.0 })
}

/// The two straightness errors whose slopes define a squareness error, such as EXY and EYX for EC0Y.
///
/// # Errors
/// `error` is not EC0Y, EA0Z or EB0Z.
pub fn squareness_parts(error: ErrorName) -> Result<[ErrorName; 2], MetrologyError> {
    use {AxisName as Axis, Component as C};
    if !error.location {
        return Err(unknown(error));
    }
    match (error.component, error.axis) {
        (C::EC, Axis::Y) => Ok([(C::EX, Axis::Y), (C::EY, Axis::X)]),
        (C::EA, Axis::Z) => Ok([(C::EY, Axis::Z), (C::EZ, Axis::Y)]),
        (C::EB, Axis::Z) => Ok([(C::EX, Axis::Z), (C::EZ, Axis::X)]),
        _ => Err(unknown(error)),
    }
    .map(|parts| parts.map(|(component, axis)| ErrorName::motion(component, axis)))
}

/// Squareness of two linear axes, positive by the right-hand rule. A positive EC0Y opens the angle from X to Y.
///
/// EC0Y = (φ − π/2) − slope(EXY) − slope(EYX), EA0Z = (φ − π/2) − slope(EYZ) − slope(EZY), EB0Z = slope(EXZ) + slope(EZX) − (φ − π/2).
///
/// `reference_angle` is φ − π/2, where φ is the angle between the + directions of the two reference beams (0 with a
/// perfect optical square). `slopes` are the two straightness errors by name, in either order, with the slopes of their
/// least-squares lines ([`ReferenceLine::slope`](crate::ReferenceLine::slope)).
///
/// # Errors
/// `error` is not a squareness error, or the slopes are not those of [`squareness_parts`].
pub fn squareness(
    error: ErrorName,
    reference_angle: Urad,
    slopes: [(ErrorName, Urad); 2],
) -> Result<Urad, MetrologyError> {
    let parts = squareness_parts(error)?;
    let [(first, slope_1), (second, slope_2)] = slopes;
    if parts != [first, second] && parts != [second, first] {
        return Err(MetrologyError::ErrorName {
            what: format!("slopes for the squareness {error}"),
            found: format!("{first}, {second}"),
            expected: format!("{} and {}", parts[0], parts[1]),
        });
    }
    let opens = reference_angle - slope_1 - slope_2;
    opening(error).map(|sign| Urad(sign * opens.0)).ok_or_else(|| unknown(error))
}

/// Squareness from a printed or cut parallelogram ABCD, positive by the right-hand rule like [`squareness`].
/// `lengths_mm` are the diagonal AC, the diagonal BD and the side AD. Corner A is at the low ends of both axes, and C
/// is opposite to A. AD may be along either axis.
///
/// With the angle α at A, AC² + BD² = 2 (AB² + AD²) and AC² − BD² = 4 AB AD cos α. The angle opens by α − π/2.
///
/// # Errors
/// `error` is not a squareness error; or no parallelogram has these lengths, one side is more than twice the other, or
/// the angle differs from 90° by 30° or more.
pub fn squareness_of_lengths(
    error: ErrorName,
    lengths_mm: [f64; 3],
) -> Result<Urad, MetrologyError> {
    squareness_parts(error)?;
    let [ac, bd, ad] = lengths_mm;
    let no_square = || MetrologyError::ErrorName {
        what: "lengths AC, BD, AD".into(),
        found: format!("{ac}, {bd}, {ad}"),
        expected: "both diagonals and one side of a square in mm, such as 141.4, 141.5, 100".into(),
    };
    let ab = (0.5 * (ac * ac + bd * bd) - ad * ad).sqrt();
    let cosine = (ac * ac - bd * bd) / (4.0 * ab * ad);
    let is_square = lengths_mm.iter().all(|length| *length > 0.0)
        && (0.5..=2.0).contains(&(ab / ad))
        && cosine.abs() < 0.5;
    let sign = opening(error).filter(|_| is_square).ok_or_else(no_square)?;
    Ok(Urad(-sign * cosine.asin() * 1e6))
}

fn unknown(error: ErrorName) -> MetrologyError {
    MetrologyError::ErrorName {
        what: "squareness from two slopes".into(),
        found: error.to_string(),
        expected: KNOWN.into(),
    }
}

/// Conditions of the measurement of two straightness lines. Unknown conditions (`None`) contribute nothing, and are
/// listed in [`SquarenessUncertainty::left_out`].
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct SquarenessInputs {
    /// Expanded uncertainty (k = 2) of the angle between the references, from the calibration of the square, µrad.
    pub square_urad: Option<f64>,
    /// Expanded uncertainty (k = 2) of the straight edge or straightness optics at any position, from its calibration,
    /// µm.
    pub straight_edge_um: Option<f64>,
    /// Range of the angle between the axes due to temperature changes during the test, µrad.
    pub temperature_urad: Option<f64>,
}

/// Expanded uncertainties of a squareness for 95.45 %, the probability of k = 2, µrad. A
/// contribution that was not stated is `None` and is not included in the combined one.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SquarenessUncertainty {
    /// Contribution of both slopes: from the scatter of the runs, or from the residuals of a single
    /// run, with Student's t.
    pub scatter_urad: f64,
    /// Contribution of the angle of the square, from its calibration.
    pub square_urad: Option<f64>,
    /// Contribution of the straight edge under both lines.
    pub straight_edge_urad: Option<f64>,
    /// Contribution of temperature changes.
    pub temperature_urad: Option<f64>,
    /// Expanded uncertainty from all contributions, µrad.
    pub whole_urad: f64,
    /// Contributions that were not stated, one text each.
    pub left_out: Vec<String>,
}

/// Evaluates the uncertainty of a squareness from the uncertainties of its two slopes. `lengths_mm` are the lengths of
/// the two lines.
///
/// The expanded uncertainties are added in quadrature, that of both slopes with Student's t. Effective degrees of
/// freedom by Welch and Satterthwaite over all contributions would give too small a result, because the scatter of few
/// runs may be small by chance. The square counts as calibrated. Independent errors U of a straight edge at both ends
/// of a line of length L turn the line by √2 U/L. A range R of the angle due to temperature counts as the range of a
/// uniform distribution, with the expanded uncertainty R/√3.
///
/// # Errors
///
/// A length that is not above zero, or a number that is negative or not finite.
pub fn squareness_uncertainty(
    inputs: &SquarenessInputs,
    slopes: [SlopeUncertainty; 2],
    lengths_mm: [f64; 2],
) -> Result<SquarenessUncertainty, MetrologyError> {
    const URAD_PER_UM_PER_MM: f64 = 1e3;
    let refuse = |what: &str, found: f64, expected: &str| {
        MetrologyError::readings("measurement uncertainty", what, found.to_string(), expected)
    };
    for length in lengths_mm {
        if !(length.is_finite() && length > 0.0) {
            return Err(refuse("length of a line, mm", length, "one above zero"));
        }
    }
    for (what, value) in [
        ("uncertainty of the square, µrad", inputs.square_urad),
        ("uncertainty of the straight edge, µm", inputs.straight_edge_um),
        ("range by temperature, µrad", inputs.temperature_urad),
        ("uncertainty of a slope, µrad", Some(slopes[0].standard_urad)),
        ("uncertainty of a slope, µrad", Some(slopes[1].standard_urad)),
    ] {
        if let Some(value) = value
            && !(0.0..=crate::text::LARGEST).contains(&value)
        {
            return Err(refuse(what, value, "a finite number of at least 0"));
        }
    }
    let scatter_urad = SlopeUncertainty::of_sum(slopes).expanded_urad();
    let straight_edge_urad = inputs.straight_edge_um.map(|u| {
        let turn = |length: f64| 2.0_f64.sqrt() * u / length * URAD_PER_UM_PER_MM;
        turn(lengths_mm[0]).hypot(turn(lengths_mm[1]))
    });
    let temperature_urad = inputs.temperature_urad.map(|range| range / 3.0_f64.sqrt());
    let named = [
        ("square", inputs.square_urad),
        ("straight edge", straight_edge_urad),
        ("temperature", temperature_urad),
    ];
    let whole_urad = named.iter().filter_map(|(_, u)| *u).fold(scatter_urad, f64::hypot);
    let left_out = named.iter().filter(|(_, u)| u.is_none());
    Ok(SquarenessUncertainty {
        scatter_urad,
        square_urad: inputs.square_urad,
        straight_edge_urad,
        temperature_urad,
        whole_urad,
        left_out: left_out.map(|(name, _)| (*name).to_owned()).collect(),
    })
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
