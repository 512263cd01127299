//! Comparison of one sensor with the other sensors of the machine. Temperatures that are not believed are NaN here.

use super::types::{MAX_SENSORS, SensorFlaw, SensorReport};

/// The fewest others that can tell whether a sensor is wrong: of two sensors nobody knows which one it is.
const FEWEST: usize = 2;

/// The median change of the others between two times, K; `None` where fewer than two were believed at both.
pub(super) fn common_change(
    before: &[f64; MAX_SENSORS],
    now: &[f64; MAX_SENSORS],
    own: usize,
) -> Option<f64> {
    let mut changes = [0.0; MAX_SENSORS];
    let mut count = 0;
    for (other, (before, now)) in before.iter().zip(now).enumerate() {
        let change = now - before;
        if other != own && change.is_finite() {
            changes[count] = change;
            count += 1;
        }
    }
    let changes = &mut changes[..count];
    changes.sort_unstable_by(f64::total_cmp);
    (count >= FEWEST).then(|| middle(count, |place| changes[place]))
}

/// Marks the good temperatures that are farther than `allowed_k` from the median of the other good ones.
pub(super) fn mark_disagreeing(told: &mut [SensorReport], allowed_k: f64) {
    let mut sorted = [0.0; MAX_SENSORS];
    let mut count = 0;
    let good = |report: &SensorReport| report.degc.filter(|_| report.flaw.is_none());
    for (place, degc) in sorted.iter_mut().zip(told.iter().filter_map(good)) {
        *place = degc;
        count += 1;
    }
    let sorted = &mut sorted[..count];
    sorted.sort_unstable_by(f64::total_cmp);
    if count <= FEWEST {
        return;
    }
    for report in told {
        let Some(degc) = good(report) else { continue };
        let own = sorted.partition_point(|other| *other < degc);
        let others = |place: usize| sorted[place + usize::from(place >= own)];
        if (degc - middle(count - 1, others)).abs() > allowed_k {
            report.flaw = Some(SensorFlaw::Disagrees);
        }
    }
}

/// The median of `count` sorted values, of which there is at least one.
fn middle(count: usize, sorted: impl Fn(usize) -> f64) -> f64 {
    0.5 * (sorted((count - 1) / 2) + sorted(count / 2))
}
