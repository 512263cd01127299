//! Positions that begin anew after a turn.

/// How far an axis went (mm or rad) whose position changed by `way`: where it begins anew after a `turn` (a rotary axis that
/// rolls over: 2π), by the shorter of the two ways round.
#[must_use]
pub fn shortest_way(way: f64, turn: Option<f64>) -> f64 {
    match turn {
        Some(turn) if turn > 0.0 => way - turn * libm::round(way / turn),
        _ => way,
    }
}
