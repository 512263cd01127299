//! All temperatures of a cycle.

use core::time::Duration;

use super::{
    check::SensorCheck,
    neighbours::mark_disagreeing,
    types::{Heard, MAX_SENSORS, SensorFlaw, SensorLimits, SensorReport},
};

/// Judges what was heard of the sensors of a machine at the time `now`. `checks` are their memories, `told` takes what
/// is believed, all in the same order; sensors beyond [`MAX_SENSORS`] are left out.
pub fn judge_temperatures(
    checks: &mut [SensorCheck],
    heard: &[Heard],
    now: Duration,
    limits: &SensorLimits,
    told: &mut [SensorReport],
) {
    // As they were before this cycle, so that no sensor is compared with one that jumps together with it.
    let believed = all_believed(checks);
    let sensors = checks.iter_mut().zip(heard).zip(told.iter_mut());
    let mut count = 0;
    for (own, ((check, heard), told)) in sensors.take(MAX_SENSORS).enumerate() {
        let flaw = check.check(now, *heard, own, &believed, limits);
        let degc = match heard {
            Heard::Temperature { degc, .. } => Some(*degc),
            Heard::Silence | Heard::Fault => None,
        };
        *told = SensorReport {
            degc: degc.filter(|_| flaw.is_none_or(SensorFlaw::is_used)),
            flaw,
        };
        count = own + 1;
    }
    let believed = all_believed(checks);
    for check in checks.iter_mut().take(count) {
        check.remember(&believed);
    }
    if let Some(allowed_k) = limits.neighbours_k {
        mark_disagreeing(&mut told[..count], allowed_k);
    }
}

/// The temperatures that are believed of all sensors, °C; NaN where there is none.
fn all_believed(checks: &[SensorCheck]) -> [f64; MAX_SENSORS] {
    let mut believed = [f64::NAN; MAX_SENSORS];
    for (degc, check) in believed.iter_mut().zip(checks) {
        *degc = check.believed();
    }
    believed
}
