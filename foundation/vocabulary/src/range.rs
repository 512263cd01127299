//! Tests whether a coordinate is within a range, and moves rotary coordinates into their travel.

/// Tolerance at the ends of a range, mm or deg. It covers the last digits that change when an end of travel is
/// converted to radians or rounded in a controller. No machine tool resolves 1e-9 mm or 1e-9 deg.
pub const COORDINATE_ROUNDING: f64 = 1e-9;

/// Whether a coordinate is in a range, including both ends, with the tolerance [`COORDINATE_ROUNDING`]; false for NaN.
/// Range and coordinate are both in mm or both in deg.
#[inline]
pub fn is_within([low, high]: [f64; 2], coordinate: f64) -> bool {
    low - COORDINATE_ROUNDING <= coordinate && coordinate <= high + COORDINATE_ROUNDING
}

/// Moves a rotary coordinate into `travel` by whole periods; all in deg. A coordinate that is within the travel, with
/// the tolerance [`COORDINATE_ROUNDING`], is unchanged, so that a coordinate at one end of the travel does not move to
/// the other end.
#[inline]
pub fn brought_into(travel: [f64; 2], period: f64, coordinate: f64) -> f64 {
    if is_within(travel, coordinate) {
        return coordinate;
    }
    // `core` has no Euclidean remainder.
    let rest = (coordinate - travel[0]) % period;
    travel[0] + if rest < 0.0 { rest + period } else { rest }
}
