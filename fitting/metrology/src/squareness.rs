//! Squareness of two linear axes, from the slopes of their straightness curves.

use volcomp_vocabulary::{AxisName, Component, ErrorName, Urad};

use crate::MetrologyError;

/// The names that [`squareness`] knows, for messages.
const KNOWN: &str = "EC0Y, EA0Z or EB0Z";

/// How a location error changes the angle between the + directions of its axis and of the one that is square to it and to the direction
/// about which it turns: a positive value opens the angle (1) or closes it (−1), as the right-hand rule has it. `None` for every error
/// that is no tilt of X, Y or Z, and for the roll of an axis about itself: no angle between these axes depends on it.
pub fn opening(error: ErrorName) -> Option<f64> {
    let linear = matches!(error.axis, AxisName::X | AxisName::Y | AxisName::Z);
    let (own, about) = (error.axis.mcs_index(), error.component.mcs_index());
    if !(error.location && linear && error.component.is_angular()) || own == about {
        return None;
    }
    // A positive tilt turns from the axis after `about` to the one before it: X to Y about Z, Y to Z about X, Z to X about Y.
    let turns_away = (about + 2) % 3 == own;
    Some(if turns_away { 1.0 } else { -1.0 })
}

/// The two straightness errors whose slopes make a squareness error: EXY and EYX for EC0Y.
///
/// # Errors
/// `error` is none of EC0Y, EA0Z, EB0Z.
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

/// Squareness of two linear axes, positive by the right-hand rule (a positive EC0Y opens the angle from X to Y).
///
/// EC0Y = (φ − π/2) − slope(EXY) − slope(EYX), EA0Z = (φ − π/2) − slope(EYZ) − slope(EZY),
/// EB0Z = slope(EXZ) + slope(EZX) − (φ − π/2).
///
/// `reference_angle` is φ − π/2, φ the angle between the + directions of the two reference beams (0 with a perfect
/// optical square). `slopes` are the two straightness errors by name, in either order, with the slopes of their
/// least-squares lines ([`ReferenceLine::slope`](crate::ReferenceLine::slope)).
///
/// # Errors
/// `error` is no squareness error, or the slopes are not those of [`squareness_parts`].
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
    opening(error)
        .map(|sign| Urad(sign * opens.0))
        .ok_or_else(|| unknown(error))
}

fn unknown(error: ErrorName) -> MetrologyError {
    MetrologyError::ErrorName {
        what: "squareness from two slopes".into(),
        found: error.to_string(),
        expected: KNOWN.into(),
    }
}
