//! Squareness of two linear axes, from the slopes of their straightness curves.

use volcomp_vocabulary::{AxisName, Component, ErrorName, Urad};

use crate::MetrologyError;

/// The names that [`squareness`] knows, for messages.
const KNOWN: &str = "EC0Y, EA0Z or EB0Z";

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
    // About Y the right-hand rule turns from Z to X.
    Ok(if error.component == Component::EB {
        -opens
    } else {
        opens
    })
}

fn unknown(error: ErrorName) -> MetrologyError {
    MetrologyError::ErrorName {
        what: "squareness from two slopes".into(),
        found: error.to_string(),
        expected: KNOWN.into(),
    }
}
