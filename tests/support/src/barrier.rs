//! Barrier of the simulated controls for tests of drivers and gateway.

use std::time::Duration;

use volcomp_guard::barrier::{Protection, Settings, SettingsError};
use volcomp_port::Axis;
use volcomp_vocabulary::{AxisName, Displacement, Mm, Rad};

/// Machine 4711: maximum 150 counts of 1 µm, 2 counts per 2 ms scan, maximum frame age 200 ms, zero after 450 ms without a frame.
pub fn protection() -> Protection {
    Protection {
        machine: 4711,
        limit: Mm(0.150),
        limit_rotary: Rad(0.01),
        rate_per_s: Mm(1.0),
        rate_rotary_per_s: Rad(0.1),
        hold: Duration::from_millis(200),
        time_out: Duration::from_millis(450),
        scan: Duration::from_millis(2),
    }
}

/// Settings of the barrier of [`protection`], for linear axes of 1 µm per count.
///
/// # Errors
/// No axes, too many, or a duplicate.
pub fn settings(axes: &[AxisName]) -> Result<Settings, SettingsError> {
    protection().settings(&self::axes(axes))
}

/// Linear axes of 1 µm per count.
pub fn axes(names: &[AxisName]) -> Vec<Axis> {
    let axis = |name: &AxisName| Axis {
        name: *name,
        includes_correction: false,
        resolution: Displacement::Length(Mm(0.001)),
        largest: None,
    };
    names.iter().map(axis).collect()
}
