//! Squareness of two linear axes, from the slopes of their straightness curves.

use crate::MetrologyError;

/// Which straightness curves make a squareness error, and its sign.
struct Definition {
    error: &'static str,
    from: [&'static str; 2],
    sign: f64,
}

const DEFINITIONS: [Definition; 3] = [
    Definition {
        error: "EC0Y",
        from: ["EXY", "EYX"],
        sign: 1.0,
    },
    Definition {
        error: "EA0Z",
        from: ["EYZ", "EZY"],
        sign: 1.0,
    },
    Definition {
        error: "EB0Z",
        from: ["EXZ", "EZX"],
        sign: -1.0,
    },
];

/// The two straightness errors whose slopes make this squareness error.
///
/// # Errors
/// `error` is none of EC0Y, EA0Z, EB0Z.
pub fn squareness_parts(error: &str) -> Result<[&'static str; 2], MetrologyError> {
    Ok(definition(error)?.from)
}

/// Squareness in µrad, positive by the right-hand rule (positive EC0Y opens the angle from X to Y).
///
/// EC0Y = (φ − π/2) − slope(EXY) − slope(EYX), EA0Z = (φ − π/2) − slope(EYZ) − slope(EZY),
/// EB0Z = slope(EXZ) + slope(EZX) − (φ − π/2).
///
/// `reference_angle_urad` is φ − π/2, φ the angle between the + directions of the two reference beams (0 with a perfect
/// optical square). `slopes_urad` are the two straightness errors by name, in either order, with their least-squares
/// slopes in µrad, which is µm/m ([`ReferenceLine::slope_urad`](crate::ReferenceLine::slope_urad)).
///
/// # Errors
/// `error` is no squareness error, or the slopes are not those it is made of.
pub fn squareness_urad(
    error: &str,
    reference_angle_urad: f64,
    slopes_urad: [(&str, f64); 2],
) -> Result<f64, MetrologyError> {
    let Definition { from, sign, .. } = definition(error)?;
    let [(first, slope_1), (second, slope_2)] = slopes_urad;
    if *from != [first, second] && *from != [second, first] {
        return Err(MetrologyError::ErrorName {
            what: format!("slopes for the squareness {error}"),
            found: format!("{first}, {second}"),
            expected: format!("{} and {}", from[0], from[1]),
        });
    }
    Ok(sign * (reference_angle_urad - slope_1 - slope_2))
}

fn definition(error: &str) -> Result<&'static Definition, MetrologyError> {
    DEFINITIONS
        .iter()
        .find(|d| d.error == error)
        .ok_or_else(|| MetrologyError::ErrorName {
            what: "squareness from two slopes".into(),
            found: error.into(),
            expected: "EC0Y, EA0Z or EB0Z".into(),
        })
}
