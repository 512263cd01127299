//! Knowledge of the applied correction, and whether sent corrections have arrived.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{Limits, Reasons, step::is_same_step};

/// A confirmed correction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Confirmed {
    /// The correction of each axis, mm or rad.
    pub values: PerChannel<f64>,
    /// Time of the last confirmation, on the clock of the cycle.
    pub at: Duration,
}

/// A control's report of its applied correction in one reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CorrectionReport<'a> {
    /// The control did not respond, or does not report corrections.
    Missing,
    /// Plain values of each axis, mm or rad.
    Values(PerChannel<f64>),
    /// The words of the report of the control's barrier.
    Barrier(&'a [u16]),
}

/// Method by which the correction of a path is confirmed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scheme {
    /// A barrier in the control accepts frames and reports the applied correction.
    Barrier,
    /// Plain values that can be read back.
    #[default]
    Plain,
    /// Plain values that cannot be read back, such as digital lines.
    NoReadBack,
}

/// A setting of a barrier that does not fit the limits of the guard: the value found and the bound. Axes are counted from 0, in channel order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BarrierMisfit {
    /// The barrier's limit is below the guard's, mm or rad.
    Limit { axis: usize, found: f64, expected: f64 },
    /// The barrier's rate is less than twice the guard's slew, mm/s or rad/s.
    Rate { axis: usize, found: f64, expected: f64 },
    /// The barrier's timeout is longer than the time after which the guard ramps out (`zero_after`).
    TimeOut { found: Duration, expected: Duration },
    /// The measured scan period differs from the configured scan period. Not returned by
    /// [`barrier_misfits`](crate::barrier_misfits), which checks settings only.
    ScanPeriod { found: Duration, expected: Duration },
}

/// The confirmed correction that a control applies, and whether the next correction may be sent.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ReadBackStatus {
    /// How the correction is confirmed.
    pub scheme: Scheme,
    /// The last confirmed correction; `None`: none yet.
    pub confirmed: Option<Confirmed>,
    /// Lowest and highest correction of each axis that may be applied: the confirmed correction and, without a barrier, the corrections sent since
    /// that may have arrived.
    pub between: [PerChannel<f64>; 2],
    /// Whether the next correction may be written: no reading contradicts the confirmed correction.
    pub writable: bool,
    /// Whether the confirmed correction was not sent by this guard: the control restarted, or another program writes.
    pub changed: bool,
    /// Time from which a sent correction has not arrived; `None`: all have arrived.
    pub unlanded_since: Option<Duration>,
    /// Time from which a control with a barrier has not moved although it accepted another correction, for a reason
    /// that no path reports. `None`: the control moves, or is at its goal.
    pub stationary_since: Option<Duration>,
    /// Maximum time from the release of a control with a barrier until its movement is reported.
    pub motion_delay: Duration,
    /// Timeout of a barrier after the last accepted frame: an older confirmation is no longer valid. `None`: no barrier
    /// reports a timeout.
    pub barrier_time_out: Option<Duration>,
    /// The first value of a barrier that does not fit the limits ([`Reasons::BARRIER_UNFIT`]).
    pub barrier_misfit: Option<BarrierMisfit>,
    /// Time, on the clock of the cycle, from which the control may ramp to zero automatically. A correction decided
    /// before this time is not sent after it. `None`: the control never ramps automatically, or it reports the ramp.
    pub control_acts_at: Option<Duration>,
    /// Why this path may not be armed, and further reasons to report.
    pub reasons: Reasons,
}

impl ReadBackStatus {
    /// Whether a nonzero correction is known to be applied.
    #[must_use]
    pub fn holds(&self, limits: &Limits) -> bool {
        self.confirmed
            .is_some_and(|confirmed| !are_equal(&confirmed.values, &PerChannel::ZERO, limits))
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Arrival {
    /// No new information about the sent words.
    Unknown,
    /// All sent words have arrived or are obsolete.
    All,
    /// Words sent from this time on have not arrived.
    Before(Duration),
}

/// Tracks since when a sent correction has not arrived.
///
/// Invariants:
/// - `since` and `failing_since` advance while the control does not answer: only time with readings counts.
/// - No word is missing if nothing was sent for longer than the path's delay.
#[derive(Clone, Debug, Default)]
pub(super) struct ArrivalMonitor {
    last_received: Option<Duration>,
    sent: Option<Duration>,
    /// Time from which a sent correction has not arrived; `None`: all have arrived.
    since: Option<Duration>,
    /// Time from which every write has failed; `None`: the last write succeeded.
    failing_since: Option<Duration>,
}

impl ArrivalMonitor {
    /// Records a write; `ok`: the write had no error. `is_unseen`: a write without an error is treated as applied.
    pub(super) fn sent(&mut self, now: Duration, ok: bool, is_unseen: bool) {
        self.sent = Some(now);
        self.failing_since = (!ok).then(|| self.failing_since.unwrap_or(now));
        self.since = if ok && is_unseen { None } else { self.since.or(Some(now)) };
    }

    pub(super) fn receive(
        &mut self,
        now: Duration,
        answered: bool,
        landed: Arrival,
        limits: &Limits,
    ) {
        let before = self.last_received.replace(now).unwrap_or(now);
        match landed {
            Arrival::Unknown => {}
            Arrival::All => self.since = None,
            Arrival::Before(since) => self.since = Some(since),
        }
        if !answered {
            // Arrival could not be observed in the meantime.
            let times = [&mut self.since, &mut self.failing_since];
            for since in times.into_iter().flatten() {
                *since += now.saturating_sub(before);
            }
        } else if self.sent.is_none_or(|sent| now.saturating_sub(sent) > limits.longest_delay()) {
            // Nothing was sent for longer than the longest delay, so missing words can no longer arrive.
            (self.since, self.failing_since) = (None, None);
        }
    }

    /// Time from which a sent correction has not arrived; `None`: all have arrived. A failed write counts as not
    /// arrived, even if the control applies its values.
    pub(super) fn unlanded_since(&self) -> Option<Duration> {
        match (self.since, self.failing_since) {
            (Some(since), Some(failing)) => Some(since.min(failing)),
            (since, failing) => since.or(failing),
        }
    }
}

/// Whether two corrections are equal on every axis, to half a step.
pub(crate) fn are_equal(a: &PerChannel<f64>, b: &PerChannel<f64>, limits: &Limits) -> bool {
    limits.places().all(|i| is_same_step(a[i], b[i], limits.axes[i].resolution))
}
