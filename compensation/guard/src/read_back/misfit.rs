//! Whether the settings of a barrier fit the limits of a guard: one rule for the cycle and for whoever asks beforehand.

use core::{ops::RangeInclusive, time::Duration};

use crate::{Limits, barrier::Settings, step::ROUNDING};

/// How far the time of a scan may be from the configured one.
const SCAN_WITHIN: RangeInclusive<f64> = 0.8..=1.25;
/// The barrier moves at least so many times as fast as the guard, so that it follows.
pub const RATE_OVER_SLEW: f64 = 2.0;

/// A setting of a barrier that does not fit the limits of the guard. Axes are counted from 0, as the channel has them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BarrierMisfit {
    /// The barrier lets less through than the guard may send.
    Limit {
        /// The axis.
        axis: usize,
        /// What the barrier lets through, mm or rad.
        found: f64,
        /// What the guard may send, mm or rad.
        expected: f64,
    },
    /// The barrier moves less than twice as fast as the guard.
    Rate {
        /// The axis.
        axis: usize,
        /// The rate of the barrier, mm or rad in a second.
        found: f64,
        /// The least rate that fits, mm or rad in a second.
        expected: f64,
    },
    /// The barrier waits longer for a frame than the guard waits until it ramps out.
    TimeOut {
        /// The time-out of the barrier.
        found: Duration,
        /// The longest that fits, the guard's `zero_after`.
        expected: Duration,
    },
}

/// Every setting of a barrier, whose control scans once in `scan`, that does not fit the limits: it has to let through what
/// the guard may send, to follow it, and to let go in time.
pub fn barrier_misfits(
    settings: &Settings,
    scan: Duration,
    limits: &Limits,
) -> impl Iterator<Item = BarrierMisfit> {
    let step_s = scan
        .saturating_mul(u32::from(settings.step_scans))
        .as_secs_f64();
    let time_out = scan.saturating_mul(u32::from(settings.time_out_scans));
    let zero_after = limits.zero_after;
    let late = (time_out > zero_after).then_some(BarrierMisfit::TimeOut {
        found: time_out,
        expected: zero_after,
    });
    let axes = limits.places().flat_map(move |axis| {
        let of_axis = &limits.axes[axis];
        let largest = f64::from(settings.limit[axis]) * of_axis.resolution;
        let rate = f64::from(settings.rate[axis]) * of_axis.resolution / step_s;
        let (most, least_rate) = (of_axis.reachable(), RATE_OVER_SLEW * of_axis.slew_per_s);
        let limit = (most > largest * ROUNDING).then_some(BarrierMisfit::Limit {
            axis,
            found: largest,
            expected: most,
        });
        let rate = (rate * ROUNDING < least_rate).then_some(BarrierMisfit::Rate {
            axis,
            found: rate,
            expected: least_rate,
        });
        limit.into_iter().chain(rate)
    });
    late.into_iter().chain(axes)
}

/// The longest time of a scan that counts as the configured one.
pub(super) fn longest_scan(scan: Duration) -> Duration {
    Duration::try_from_secs_f64(scan.as_secs_f64() / SCAN_WITHIN.start()).unwrap_or(Duration::MAX)
}

/// Whether so many scans in this time are those of a control that scans once in `scan`.
#[must_use]
pub fn scans_fit(scans: u32, passed: Duration, scan: Duration) -> bool {
    let expected = scan.as_secs_f64() * f64::from(scans);
    SCAN_WITHIN.contains(&(expected / passed.as_secs_f64()))
}
