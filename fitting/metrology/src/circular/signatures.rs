//! Error signatures in the shape of a trace. They are fitted together by least squares, and ranked.
//!
//! θ is the angle from the first axis to the second, d = ±1 the sense, R the radius, and (R cos θ, R sin θ) the path:
//!
//! | signature | radial deviation |
//! | --- | --- |
//! | centre offset (a, b) | a cos θ + b sin θ |
//! | squareness γ, which opens the angle between the axes | −γ R/2 · sin 2θ |
//! | scale mismatch m = scale of the first minus that of the second axis | m R/2 · cos 2θ |
//! | reversal value B of the first axis | −d B/2 · cos θ · sgn(sin θ) |
//! | reversal value B of the second axis | d B/2 · sin θ · sgn(cos θ) |
//! | servo mismatch c | d c · sin 2θ |
//! | reversal spike | p · exp(−Δ/τ), Δ the angle since the reversal of the axis |

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{DMatrix, DVector};

use super::{CircularTrace, Sense, TracePoint};
use crate::text::range;
use crate::{DeviationUnit, MetrologyError};

/// Error source of a signature.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum SignatureKind {
    /// Squareness error of the two axes.
    Squareness,
    /// The scales of the two axes differ.
    ScaleMismatch,
    /// Reversal value of the first axis.
    BacklashFirst,
    /// Reversal value of the second axis.
    BacklashSecond,
    /// Different delays of the two axes.
    ServoMismatch,
    /// Reversal spikes of the first axis, at 0° and 180°.
    SpikesFirst,
    /// Reversal spikes of the second axis, at 90° and 270°.
    SpikesSecond,
}

impl SignatureKind {
    /// Name of the error source in documents.
    pub fn key(self) -> &'static str {
        match self {
            Self::Squareness => "squareness",
            Self::ScaleMismatch => "scale-mismatch",
            Self::BacklashFirst => "backlash-first",
            Self::BacklashSecond => "backlash-second",
            Self::ServoMismatch => "servo-mismatch",
            Self::SpikesFirst => "spikes-first",
            Self::SpikesSecond => "spikes-second",
        }
    }
}

/// Fitted effect of one error source on a circular trace.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Signature {
    /// The error source.
    pub kind: SignatureKind,
    /// Size: squareness µrad, positive if it opens the angle between the axes; scale mismatch µm/m
    /// (µrad); reversal value µm, as B = x̄↑ − x̄↓; servo mismatch µm, radial at 45°; spikes µm,
    /// positive outward, the mean of both places.
    pub size: f64,
    /// The unit of the size.
    pub unit: DeviationUnit,
    /// Expanded uncertainty (k = 2) of the size, from the residuals of the fit, in the same unit.
    pub uncertainty: f64,
    /// Circular deviation due to this signature alone: the range of its radial deviation, µm.
    pub range_um: f64,
    /// `range_um` divided by the sum of the ranges of all signatures.
    pub share: f64,
}

#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Signatures {
    /// Signatures by descending range. A trace in one sense has no servo mismatch, because the servo mismatch cannot be
    /// separated from the squareness. The squareness then contains both.
    pub ranked: Vec<Signature>,
    /// Removed centre offset along the first and the second axis, µm. It depends on the set-up instead of the machine.
    pub centre_um: [f64; 2],
    /// Mean deviation of the radius, µm. It depends on the length of the ballbar, the feed and the mean scale.
    pub radius_um: f64,
    /// Spikes at 0°, 90°, 180° and 270°, µm, positive outward; `None` if the trace does not pass the angle. The ranked
    /// signatures use the mean of the passed angles of an axis. They omit the spikes of an axis if neither of its
    /// angles is passed.
    pub spikes_um: [Option<f64>; 4],
    /// Angle over which a spike decays to 1/e, deg. It is undefined if none of the four angles is passed.
    pub spike_width_deg: f64,
    /// Root mean square of the residuals after all signatures, µm.
    pub rms_left_um: f64,
}

const WIDTHS_DEG: [f64; 8] = [0.7, 1.0, 1.5, 2.0, 3.0, 4.5, 6.0, 9.0];
/// Maximum condition number of the normal equations. Above it the signatures are not separable.
const WORST_CONDITION: f64 = 1e4;

/// Fits all signatures to a trace.
///
/// # Errors
/// Too few points, or an arc on which the signatures are not separable.
pub fn circular_signatures(trace: &CircularTrace) -> Result<Signatures, MetrologyError> {
    let points = &trace.points;
    let both = Sense::BOTH.into_iter().all(|sense| trace.has(sense));
    let right = DVector::from_iterator(points.len(), points.iter().map(|p| p.deviation_um));
    let passed = passed(points);
    let at = |width_deg: f64| {
        let columns = design(points, both, width_deg.to_radians());
        solve(points, &columns, passed, &right, width_deg)
    };
    let tried: Vec<Option<Fit>> = WIDTHS_DEG.iter().map(|width| at(*width)).collect();
    let squares = |fit: &Option<Fit>| fit.as_ref().map_or(f64::INFINITY, |fit| fit.squares);
    let best = (0..tried.len()).min_by(|a, b| squares(&tried[*a]).total_cmp(&squares(&tried[*b])));
    let best = best.unwrap_or_default();
    let fit = tried[best].as_ref().map(|_| {
        let below = WIDTHS_DEG[best.saturating_sub(1)];
        let above = WIDTHS_DEG[(best + 1).min(WIDTHS_DEG.len() - 1)];
        narrowed([below, above], &at)
    });
    let fit = fit.flatten().ok_or_else(|| {
        MetrologyError::readings(
            trace.name.clone(),
            "signatures",
            format!("{} points on which they look alike", points.len()),
            "points all around the circle, at every degree or so",
        )
    })?;
    Ok(fit.signatures(points, both, trace.radius_mm))
}

/// For each of the four reversals, whether the trace has a point within 2° after the reversal, or within 1.5 times the
/// median spacing of the points if that is more. Otherwise the reversal spike has decayed at the next point, and its
/// size is undetermined.
fn passed(points: &[TracePoint]) -> [bool; 4] {
    const NEAR_DEG: f64 = 2.0;
    let mut steps: Vec<f64> = (points.windows(2))
        .filter(|pair| pair[0].sense == pair[1].sense)
        .map(|pair| since(&pair[1], pair[0].angle_rad))
        .map(|step| step.min(TAU - step))
        .collect();
    steps.sort_by(f64::total_cmp);
    let step = steps.get(steps.len() / 2).copied().unwrap_or_default();
    let near = NEAR_DEG.to_radians().max(1.5 * step);
    PLACES.map(|place| points.iter().any(|p| since(p, place) <= near))
}

/// Least-squares fit with the best spike width between two widths (deg), by golden-section search; `None` if `at` fails
/// at a tried width.
fn narrowed([mut low, mut high]: [f64; 2], at: &dyn Fn(f64) -> Option<Fit>) -> Option<Fit> {
    const STEPS: usize = 14;
    const GOLDEN: f64 = 0.618_033_988_749_894_8;
    for _ in 0..STEPS {
        let step = GOLDEN * (high - low);
        let [left, right] = [high - step, low + step];
        if at(left)?.squares < at(right)?.squares {
            high = right;
        } else {
            low = left;
        }
    }
    at(f64::midpoint(low, high))
}

/// Number of columns: radius, centre (two), sin 2θ, cos 2θ, two reversal values and four spikes. The servo mismatch is
/// a further column if the trace has both senses.
const COUNT: usize = 11;
/// Column of the spike at 0°.
const FIRST_SPIKE: usize = 7;

/// Angle travelled since the angle `place` in the sense of motion, modulo a full turn, rad.
fn since(p: &TracePoint, place: f64) -> f64 {
    (p.sense.sign() * (p.angle_rad - place)).rem_euclid(TAU)
}

/// Angles of the spikes, rad.
const PLACES: [f64; 4] = [0.0, FRAC_PI_2, PI, PI + FRAC_PI_2];

fn row(p: &TracePoint, both: bool, width_rad: f64) -> Vec<f64> {
    let (sin, cos) = p.angle_rad.sin_cos();
    let d = p.sense.sign();
    // At the reversal itself the axis is at rest, so its sign is 0.
    let side = |x: f64| if x == 0.0 { 0.0 } else { x.signum() };
    let spike = |place: f64| {
        let since = (d * (p.angle_rad - place)).rem_euclid(TAU);
        if since < PI { (-since / width_rad).exp() } else { 0.0 }
    };
    let mut row = vec![
        1.0,
        cos,
        sin,
        2.0 * sin * cos,
        cos * cos - sin * sin,
        -0.5 * d * cos * side(sin),
        0.5 * d * sin * side(cos),
        spike(PLACES[0]),
        spike(PLACES[1]),
        spike(PLACES[2]),
        spike(PLACES[3]),
    ];
    if both {
        row.push(d * 2.0 * sin * cos);
    }
    row
}

fn design(points: &[TracePoint], both: bool, width_rad: f64) -> DMatrix<f64> {
    let columns = COUNT + usize::from(both);
    let rows = points.iter().flat_map(|p| row(p, both, width_rad));
    DMatrix::from_row_iterator(points.len(), columns, rows)
}

struct Fit {
    found: DVector<f64>,
    /// Variance of each coefficient for fixed widths of the spikes; 0 for spikes without a column.
    variances: Vec<f64>,
    passed: [bool; 4],
    squares: f64,
    rms: f64,
    width_deg: f64,
}

fn solve(
    points: &[TracePoint],
    columns: &DMatrix<f64>,
    passed: [bool; 4],
    right: &DVector<f64>,
    width_deg: f64,
) -> Option<Fit> {
    // Omit the column of a spike whose angle is not passed, because the column would be numerically zero.
    let is_seen = |column: &usize| {
        let spike = column.checked_sub(FIRST_SPIKE);
        spike.and_then(|spike| passed.get(spike)) != Some(&false)
    };
    let seen: Vec<usize> = (0..columns.ncols()).filter(is_seen).collect();
    let chosen = columns.select_columns(&seen);
    let (rows, unknowns) = chosen.shape();
    if rows <= unknowns + 1 || !right.iter().all(|x| x.is_finite()) {
        return None;
    }
    let (inverse, lengths, scaled) = inverse_of_normal(&chosen)?;
    let mut sizes = &inverse * (scaled.transpose() * right);
    let squares = (right - &scaled * &sizes).norm_squared();
    for (k, length) in lengths.iter().enumerate() {
        sizes[k] /= length;
    }
    let mut found = DVector::zeros(columns.ncols());
    for (size, column) in sizes.iter().zip(&seen) {
        found[*column] = *size;
    }
    let variance = squares / (rows - unknowns) as f64;
    let of = |inverse: &DMatrix<f64>, lengths: &[f64]| -> Vec<f64> {
        let mut variances = vec![0.0; columns.ncols()];
        for (k, column) in seen.iter().enumerate() {
            variances[*column] = variance * inverse[(k, k)] / (lengths[k] * lengths[k]);
        }
        variances
    };
    // The width of the spikes was fitted too, so add its uncertainty to the uncertainty of their sizes.
    let width = width_deg.to_radians();
    let derivative = |p: &TracePoint| -> f64 {
        let at = |k: usize| {
            let since = since(p, PLACES[k]);
            found[FIRST_SPIKE + k] * (-since / width).exp() * since / (width * width)
        };
        (0..PLACES.len()).map(at).sum()
    };
    let widths = points.iter().map(derivative);
    let mut wider = chosen.insert_column(unknowns, 0.0);
    for (row, value) in widths.enumerate() {
        wider[(row, unknowns)] = value;
    }
    let variances = match inverse_of_normal(&wider) {
        Some((inverse, lengths, _)) => of(&inverse, &lengths),
        None => of(&inverse, &lengths),
    };
    Some(Fit { found, variances, passed, squares, rms: (squares / rows as f64).sqrt(), width_deg })
}

/// Scales the columns to length 1. Returns the inverse of their normal matrix, the original lengths, and the scaled
/// columns; `None` if the columns are not separable.
fn inverse_of_normal(columns: &DMatrix<f64>) -> Option<(DMatrix<f64>, Vec<f64>, DMatrix<f64>)> {
    let lengths: Vec<f64> = columns.column_iter().map(|c| c.norm()).collect();
    if !lengths.iter().all(|length| *length > 0.0) {
        return None;
    }
    let mut scaled = columns.clone();
    for (mut column, length) in scaled.column_iter_mut().zip(&lengths) {
        column /= *length;
    }
    let normal = scaled.transpose() * &scaled;
    let eigen = normal.clone().symmetric_eigenvalues();
    if eigen.min() * WORST_CONDITION * WORST_CONDITION < eigen.max() {
        return None;
    }
    Some((normal.cholesky()?.inverse(), lengths, scaled))
}

impl Fit {
    fn signatures(&self, points: &[TracePoint], both: bool, radius_mm: f64) -> Signatures {
        use SignatureKind as Kind;
        const URAD_PER_UM_PER_MM: f64 = 1e3;
        let found = &self.found;
        let per_radius = 2.0 / radius_mm * URAD_PER_UM_PER_MM;
        // Range over the points of the combined effect of the columns of a signature.
        let range_of = |columns: &[usize]| {
            let width = self.width_deg.to_radians();
            let at = |p: &TracePoint| {
                let row = row(p, both, width);
                columns.iter().map(|k| row[*k] * found[*k]).sum::<f64>()
            };
            let [low, high] = range(points.iter().map(at));
            high - low
        };
        let one = |kind, column: usize, factor: f64, unit| Signature {
            kind,
            size: factor * found[column],
            unit,
            uncertainty: 2.0 * factor.abs() * self.variances[column].sqrt(),
            range_um: range_of(&[column]),
            share: 0.0,
        };
        // The mean over the passed angles.
        let pair = |kind, places: [usize; 2]| {
            let seen = places.into_iter().filter(|place| self.passed[*place]);
            let columns: Vec<usize> = seen.map(|place| FIRST_SPIKE + place).collect();
            let count = columns.len() as f64;
            let sum = columns.iter().map(|k| found[*k]).sum::<f64>();
            let variance = columns.iter().map(|k| self.variances[*k]).sum::<f64>();
            (!columns.is_empty()).then(|| Signature {
                kind,
                size: sum / count,
                unit: DeviationUnit::Um,
                uncertainty: 2.0 / count * variance.sqrt(),
                range_um: range_of(&columns),
                share: 0.0,
            })
        };
        let mut ranked = vec![
            one(Kind::Squareness, 3, -per_radius, DeviationUnit::Urad),
            one(Kind::ScaleMismatch, 4, per_radius, DeviationUnit::Urad),
            one(Kind::BacklashFirst, 5, 1.0, DeviationUnit::Um),
            one(Kind::BacklashSecond, 6, 1.0, DeviationUnit::Um),
        ];
        ranked.extend(pair(Kind::SpikesFirst, [0, 2]));
        ranked.extend(pair(Kind::SpikesSecond, [1, 3]));
        if both {
            ranked.push(one(Kind::ServoMismatch, 11, 1.0, DeviationUnit::Um));
        }
        let sum: f64 = ranked.iter().map(|s| s.range_um).sum();
        for signature in &mut ranked {
            signature.share = if sum > 0.0 { signature.range_um / sum } else { 0.0 };
        }
        ranked.sort_by(|a, b| b.range_um.total_cmp(&a.range_um));
        Signatures {
            ranked,
            centre_um: [found[1], found[2]],
            radius_um: found[0],
            spikes_um: std::array::from_fn(|place| {
                self.passed[place].then(|| found[FIRST_SPIKE + place])
            }),
            spike_width_deg: self.width_deg,
            rms_left_um: self.rms,
        }
    }
}
