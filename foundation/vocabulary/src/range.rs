//! Whether a coordinate is within a range, and moving a rotary coordinate into its travel.

/// Tolerance at the ends of a range, mm or deg. Conversion of an end of travel to radians, or rounding in a controller, changes its last digits;
/// no machine tool resolves a nanodegree or a picometre.
pub const COORDINATE_ROUNDING: f64 = 1e-9;

/// Whether a coordinate is in a range, both ends included, with a tolerance for rounding; false for NaN. Both in mm or both in deg.
#[inline]
pub fn is_within([low, high]: [f64; 2], coordinate: f64) -> bool {
    low - COORDINATE_ROUNDING <= coordinate && coordinate <= high + COORDINATE_ROUNDING
}

/// Moves a rotary coordinate into `travel` by whole periods, all in deg. A coordinate within the travel, with a tolerance for rounding, is
/// unchanged, so that a coordinate at one end of travel does not move to the other.
#[inline]
pub fn brought_into(travel: [f64; 2], period: f64, coordinate: f64) -> f64 {
    if is_within(travel, coordinate) {
        return coordinate;
    }
    // Euclidean remainder, which `core` lacks.
    let rest = (coordinate - travel[0]) % period;
    travel[0] + if rest < 0.0 { rest + period } else { rest }
}
