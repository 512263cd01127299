//! The clock of the centre, for people: no machine decides anything by it.

use std::time::{SystemTime, UNIX_EPOCH};

/// Seconds since 1970, to the millisecond: so many digits are the same number again when they were written and read. 0 where
/// the clock stands before 1970.
pub fn now_s() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .map_or(0.0, |since| (since.as_secs_f64() * 1e3).round() / 1e3)
}
