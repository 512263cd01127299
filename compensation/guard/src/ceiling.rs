//! Hard ceilings: whatever a configuration states, no guard accepts limits beyond these numbers. A correction of a
//! machine's geometry is some tenths of a millimetre; more is a mistake in a file, and would move the machine.

use core::time::Duration;

use volcomp_vocabulary::{AxisKind, Mm, Rad, bounds};

/// The largest limit of the correction of a linear axis.
pub const LIMIT: Mm = bounds::LARGEST_CORRECTION;
/// The largest limit of the correction of a rotary axis.
pub const LIMIT_ROTARY: Rad = bounds::LARGEST_CORRECTION_ROTARY;
/// The largest rate of the correction of a linear axis, in a second.
pub const SLEW_PER_S: Mm = Mm(5.0);
/// The largest rate of the correction of a rotary axis, in a second.
pub const SLEW_PER_S_ROTARY: Rad = Rad(0.005);
/// The shortest time of a cycle.
pub const SHORTEST_CYCLE: Duration = Duration::from_micros(250);
/// The longest time of a cycle.
pub const LONGEST_CYCLE: Duration = Duration::from_millis(100);
/// The longest time for which a correction may be held while positions are missing, and after which nothing is sent any more
/// that was decided before.
pub const HOLD: Duration = Duration::from_millis(200);
/// The same for a correction of thermal terms alone, which change slowly wherever the machine goes.
pub const HOLD_THERMAL: Duration = Duration::from_secs(5);

/// The largest limit (mm or rad) and the largest rate (mm/s or rad/s) of an axis of this kind.
pub(crate) fn of(kind: AxisKind) -> [f64; 2] {
    match kind {
        AxisKind::Linear => [LIMIT.0, SLEW_PER_S.0],
        AxisKind::Rotary => [LIMIT_ROTARY.0, SLEW_PER_S_ROTARY.0],
    }
}
