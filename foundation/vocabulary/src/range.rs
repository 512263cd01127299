//! Whether a coordinate is within a range, and how a rotary coordinate is brought into its travel: one rule for all.

/// A coordinate (mm or deg) that lies beyond the end of a range by no more than this is within the range. An end of
/// travel passes through radians, or through the sums of a controller, and comes back a few units of its last digit
/// off; no machine tool resolves a nanodegree or a picometre.
pub const COORDINATE_ROUNDING: f64 = 1e-9;

/// Whether a coordinate lies in a range, both ends included, but for rounding; never for NaN. All in mm or all in deg.
#[inline]
pub fn is_within([low, high]: [f64; 2], coordinate: f64) -> bool {
    low - COORDINATE_ROUNDING <= coordinate && coordinate <= high + COORDINATE_ROUNDING
}

/// A rotary coordinate, deg, brought into the travel by whole periods. One that is within the travel, but for
/// rounding, stays, so that an end of travel keeps its side.
#[inline]
pub fn brought_into(travel: [f64; 2], period: f64, coordinate: f64) -> f64 {
    if is_within(travel, coordinate) {
        return coordinate;
    }
    // The Euclidean remainder, which `core` lacks.
    let rest = (coordinate - travel[0]) % period;
    travel[0] + if rest < 0.0 { rest + period } else { rest }
}
