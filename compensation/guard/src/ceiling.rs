//! Hard ceilings: no guard accepts limits beyond these, regardless of the configuration. A geometric correction is some tenths of a millimetre;
//! more is a configuration error, and would move the machine.

use core::time::Duration;

use volcomp_vocabulary::{AxisKind, Mm, Rad, bounds};

/// Maximum correction limit of a linear axis.
pub const LIMIT: Mm = bounds::LARGEST_CORRECTION;
/// Maximum correction limit of a rotary axis.
pub const LIMIT_ROTARY: Rad = bounds::LARGEST_CORRECTION_ROTARY;
/// Maximum rate of the correction of a linear axis, per second.
pub const SLEW_PER_S: Mm = Mm(5.0);
/// Maximum rate of the correction of a rotary axis, per second.
pub const SLEW_PER_S_ROTARY: Rad = Rad(0.005);
/// Minimum cycle period.
pub const SHORTEST_CYCLE: Duration = Duration::from_micros(250);
/// Maximum cycle period.
pub const LONGEST_CYCLE: Duration = Duration::from_millis(100);
/// Maximum time for which a correction may be held without positions, and maximum age of a decision that is still sent.
pub const HOLD: Duration = Duration::from_millis(200);
/// Maximum hold time of a correction of thermal terms alone, which change slowly at any position.
pub const HOLD_THERMAL: Duration = Duration::from_secs(5);

/// Maximum limit (mm or rad) and maximum rate (mm/s or rad/s) of an axis of this kind.
pub(crate) fn of(kind: AxisKind) -> [f64; 2] {
    match kind {
        AxisKind::Linear => [LIMIT.0, SLEW_PER_S.0],
        AxisKind::Rotary => [LIMIT_ROTARY.0, SLEW_PER_S_ROTARY.0],
    }
}
