//! Deviations of ISO 230-4, about the centre of the least-squares circle.

use nalgebra::{Matrix3, Vector3};

use super::{CircularTrace, Sense, TracePoint};
use crate::number::range;
use crate::{MetrologyError, StandardQuantity};

/// Deviations of a circular test, µm. Each circle is fitted by least squares, to first order in deviation/radius.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct CircularDeviations {
    /// Circular deviation G of each sense, counter-clockwise first: range of the radii about the centre of the circle
    /// of that sense.
    pub g_um: [Option<f64>; 2],
    /// Bidirectional circular deviation G(b): range of the radii of both senses about the centre of their common
    /// circle.
    pub g_b_um: Option<f64>,
    /// Largest radial deviation F_max of each sense from the nominal radius, about the centre of the circle of that
    /// sense; `None` unless the radius was stated.
    pub f_max_um: [Option<f64>; 2],
    /// Smallest radial deviation F_min of each sense from the nominal radius, about the centre of the circle of that
    /// sense; `None` unless the radius was stated.
    pub f_min_um: [Option<f64>; 2],
    /// Mean bidirectional radial deviation D: radius of the circle through both senses minus the nominal radius.
    pub d_um: Option<f64>,
    /// Centre offset that was removed, along the first and the second axis, µm.
    pub centre_um: [f64; 2],
}

/// Evaluates a trace by ISO 230-4.
///
/// # Errors
/// The points of a sense do not determine a circle, or contain numbers that are not finite.
pub fn circular_deviations(trace: &CircularTrace) -> Result<CircularDeviations, MetrologyError> {
    let mut found = CircularDeviations {
        g_um: [None; 2],
        g_b_um: None,
        f_max_um: [None; 2],
        f_min_um: [None; 2],
        d_um: None,
        centre_um: [0.0; 2],
    };
    let all = circle(&trace.points, &trace.name)?;
    found.centre_um = [all[1], all[2]];
    for (k, sense) in Sense::BOTH.into_iter().enumerate() {
        let points = trace.of(sense);
        if points.is_empty() {
            continue;
        }
        let centred = about(&points, circle(&points, &trace.name)?);
        let [low, high] = range(centred.into_iter());
        found.g_um[k] = Some(high - low);
        if trace.radius_is_stated {
            found.f_max_um[k] = Some(high);
            found.f_min_um[k] = Some(low);
        }
    }
    if found.g_um.iter().all(Option::is_some) {
        let [low, high] = range(about(&trace.points, all).into_iter());
        found.g_b_um = Some(high - low);
        found.d_um = trace.radius_is_stated.then_some(all[0]);
    }
    Ok(found)
}

impl CircularDeviations {
    pub fn quantities(&self) -> Vec<StandardQuantity> {
        let larger = |values: [Option<f64>; 2]| values.into_iter().flatten().reduce(f64::max);
        let smaller = |values: [Option<f64>; 2]| values.into_iter().flatten().reduce(f64::min);
        [
            ("G_ccw", "circular deviation, counter-clockwise", self.g_um[0]),
            ("G_cw", "circular deviation, clockwise", self.g_um[1]),
            ("G_b", "bidirectional circular deviation", self.g_b_um),
            ("F_max", "largest radial deviation", larger(self.f_max_um)),
            ("F_min", "smallest radial deviation", smaller(self.f_min_um)),
            ("D", "mean bidirectional radial deviation", self.d_um),
        ]
        .map(|(symbol, name, value)| StandardQuantity::new(symbol, name, value))
        .to_vec()
    }
}

/// Least-squares circle through the radial deviations δ. Returns the radius deviation r and the centre (a, b) in δ =
/// r + a cos θ + b sin θ, µm.
fn circle(points: &[TracePoint], name: &str) -> Result<Vector3<f64>, MetrologyError> {
    let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
    for p in points {
        let (sin, cos) = p.angle_rad.sin_cos();
        let row = Vector3::new(1.0, cos, sin);
        normal += row * row.transpose();
        right += row * p.deviation_um;
    }
    let singular = normal.singular_values();
    let strong = singular.min() > 1e-9 * singular.max();
    let solved = if strong { normal.lu().solve(&right) } else { None };
    solved.filter(|s| s.iter().all(|x| x.is_finite())).ok_or_else(|| {
        MetrologyError::readings(
            name,
            "points",
            "an arc too short for a centre, or numbers that are not finite",
            "points around the circle",
        )
    })
}

/// Radial deviations about the centre of `circle`, µm.
fn about(points: &[TracePoint], circle: Vector3<f64>) -> Vec<f64> {
    let centred = |p: &TracePoint| {
        let (sin, cos) = p.angle_rad.sin_cos();
        p.deviation_um - circle[1] * cos - circle[2] * sin
    };
    points.iter().map(centred).collect()
}
