//! Checks whether a coordinate is within a range, and moves a rotary coordinate into its travel: one rule for all crates.

/// Tolerance at the ends of a range, mm or deg. Conversion of an end of travel to radians, or rounding in a controller, changes its last digits;
/// no machine tool resolves a nanodegree or a picometre.
pub const COORDINATE_ROUNDING: f64 = 1e-9;

/// Whether a coordinate lies in a range, both ends included, with a tolerance for rounding; false for NaN. All in mm or all in deg.
#[inline]
pub fn is_within([low, high]: [f64; 2], coordinate: f64) -> bool {
    low - COORDINATE_ROUNDING <= coordinate && coordinate <= high + COORDINATE_ROUNDING
}

/// Moves a rotary coordinate, deg, into the travel by whole periods. A coordinate within the travel, with a tolerance for rounding, is unchanged, so
/// that an end of travel keeps its side.
#[inline]
pub fn brought_into(travel: [f64; 2], period: f64, coordinate: f64) -> f64 {
    if is_within(travel, coordinate) {
        return coordinate;
    }
    // Euclidean remainder, which `core` lacks.
    let rest = (coordinate - travel[0]) % period;
    travel[0] + if rest < 0.0 { rest + period } else { rest }
}
