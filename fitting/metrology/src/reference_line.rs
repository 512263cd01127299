//! Reference lines of a straightness profile (ISO 230-1).

use volcomp_vocabulary::Urad;

use crate::MetrologyError;

/// Definition of the reference line of a straightness profile. ISO 230-1 names all three.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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
pub(crate) fn check_points(name: &str, points: &[(f64, f64)]) -> Result<(), MetrologyError> {
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
