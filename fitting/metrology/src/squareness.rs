//! Squareness of two linear axes from the slopes of their straightness curves, and its measurement uncertainty.

use volcomp_vocabulary::{AxisName, Component, ErrorName, Urad};

use crate::{MetrologyError, SlopeUncertainty};

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
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
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
#[derive(Debug, Clone, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
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
            && !(0.0..=crate::number::LARGEST).contains(&value)
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
