//! Straightness: profiles from bridge readings, the reference lines of ISO 230-1, and the straightness error about each
//! line.

use volcomp_vocabulary::{AxisName, ErrorName};

use crate::number::range;
use crate::reference_line::check_points;
use crate::{
    Direction, Measurement, MetrologyError, MotionKind, Quantity, ReferenceKind, ReferenceLine,
    SlopeUncertainty,
};

/// Sign convention of bridge tilt readings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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

#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct StraightnessAbout {
    pub kind: ReferenceKind,
    pub line: ReferenceLine,
    /// Straightness error, µm: the range of the profile about the line.
    pub error_um: f64,
}

#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
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
