//! Knowledge of the correction that a control applies.
//!
//! A received value is not used before it is confirmed, and a sent correction is not considered applied before it is read back. The method
//! depends on the control: a [`barrier`](crate::barrier), words that can be read back, or neither.

mod barrier;
mod echo;
mod no_read_back;
mod status;

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{Limits, barrier::FRAME_WORDS};

pub use barrier::{BarrierLink, RATE_OVER_SLEW, barrier_misfits, scans_fit};
pub use no_read_back::ControlTimeOut;
pub(crate) use status::are_equal;
pub use status::{BarrierMisfit, Confirmed, CorrectionReport, ReadBackStatus, Scheme};

use echo::Echo;
use no_read_back::NoReadBack;
use status::{Arrival, ArrivalMonitor};

/// The read-back of one path. State: the sent corrections, the received values, and the status derived from both.
///
/// Invariants:
/// - `status.between` contains the confirmed correction and, without a barrier, every later correction that may have
///   arrived.
/// - `status.unlanded_since` equals that of `arrivals`.
/// - `status.scheme` belongs to `kind` and never changes.
#[derive(Clone, Debug)]
pub struct ReadBack {
    kind: Kind,
    status: ReadBackStatus,
    arrivals: ArrivalMonitor,
}

#[derive(Clone, Debug)]
enum Kind {
    Barrier(BarrierLink),
    Echo(Echo),
    NoReadBack(NoReadBack),
}

impl ReadBack {
    /// Read-back of a control with a barrier.
    #[must_use]
    pub fn barrier(link: BarrierLink) -> Self {
        Self::of(Kind::Barrier(link), Scheme::Barrier)
    }

    /// Read-back of a control without a barrier that reports its correction. Before the first write, the correction
    /// must not change for the time `watch`: a change reveals another gateway, or a control that is still ramping to
    /// zero.
    #[must_use]
    pub fn plain(watch: Duration) -> Self {
        Self::of(Kind::Echo(Echo::new(watch)), Scheme::Plain)
    }

    /// Read-back of a control that does not report its correction. `control` is the time without a write after which
    /// the control ramps to zero automatically; `None`: the control keeps its correction.
    #[must_use]
    pub fn no_read_back(control: Option<ControlTimeOut>) -> Self {
        Self::of(Kind::NoReadBack(NoReadBack::new(control)), Scheme::NoReadBack)
    }

    fn of(kind: Kind, scheme: Scheme) -> Self {
        Self {
            kind,
            status: ReadBackStatus { scheme, ..ReadBackStatus::default() },
            arrivals: ArrivalMonitor::default(),
        }
    }

    /// Status after the last call.
    #[must_use]
    pub fn status(&self) -> &ReadBackStatus {
        &self.status
    }

    /// Processes the control's report in this cycle. `taken` is the time at which the report was valid. Reports older
    /// than `hold` are ignored, even if a device repeats them.
    pub fn receive(
        &mut self,
        now: Duration,
        taken: Duration,
        report: &CorrectionReport<'_>,
        limits: &Limits,
    ) {
        // A device may report a future time; clamp it to now.
        let taken = taken.min(now);
        let is_old = now.saturating_sub(taken) > limits.hold;
        let report = if is_old { &CorrectionReport::Missing } else { report };
        self.status.changed = false;
        let landed = match (&mut self.kind, report) {
            (Kind::Barrier(link), CorrectionReport::Barrier(words)) => {
                link.receive(taken, words, limits, &mut self.status)
            }
            (Kind::Barrier(_), _) => Arrival::Unknown,
            (Kind::Echo(echo), CorrectionReport::Values(values)) => {
                echo.receive(now, taken, values, limits, &mut self.status)
            }
            (Kind::Echo(_), _) => {
                self.status.writable = false;
                Arrival::Unknown
            }
            (Kind::NoReadBack(lines), report) => {
                lines.receive(now, taken, report, limits, &mut self.status)
            }
        };
        match &self.kind {
            Kind::Barrier(link) => link.judge(now, limits, &mut self.status),
            Kind::Echo(echo) => echo.judge(now, limits, &mut self.status),
            Kind::NoReadBack(_) => {}
        }
        let is_observed = match &self.kind {
            Kind::Barrier(_) | Kind::Echo(_) => true,
            Kind::NoReadBack(lines) => lines.has_reported(),
        };
        // A device that has never reported its outputs is assumed to answer.
        let answered = !is_observed || *report != CorrectionReport::Missing;
        self.arrivals.receive(now, answered, landed, limits);
        self.update_status();
    }

    /// Whether the device reports the applied correction, so that the arrival of sent corrections
    /// can be observed.
    fn observes_arrival(&self) -> bool {
        match &self.kind {
            Kind::Barrier(_) | Kind::Echo(_) => true,
            Kind::NoReadBack(lines) => lines.reports_now(),
        }
    }

    fn update_status(&mut self) {
        self.status.unlanded_since = self.arrivals.unlanded_since();
        let candidates = match &self.kind {
            Kind::Echo(echo) => echo.between(),
            Kind::NoReadBack(lines) => lines.between(),
            Kind::Barrier(_) => None,
        };
        let confirmed = self.status.confirmed.map_or(PerChannel::ZERO, |c| c.values);
        self.status.between = candidates.unwrap_or([confirmed; 2]);
    }

    /// Reports that another gateway was detected on this path.
    pub fn report_other_gateway(&mut self, now: Duration) {
        if let Kind::Echo(echo) = &mut self.kind {
            echo.report_other_gateway(now);
        }
    }

    /// Encodes the frame that requests a correction (mm, rad), for a control with a barrier, and returns its number of
    /// words; `None` if no frame may be sent now. Send the frame at once.
    pub fn frame(
        &mut self,
        values: &PerChannel<f64>,
        limits: &Limits,
        words: &mut [u16; FRAME_WORDS],
    ) -> Option<usize> {
        match &mut self.kind {
            Kind::Barrier(link) => link.frame(values, limits, words),
            Kind::Echo(_) | Kind::NoReadBack(_) => None,
        }
    }

    /// Epoch and sequence of the last frame to a barrier.
    #[must_use]
    pub fn last_frame(&self) -> Option<(u16, u16)> {
        match &self.kind {
            Kind::Barrier(link) => link.last_frame(),
            Kind::Echo(_) | Kind::NoReadBack(_) => None,
        }
    }

    /// Records a frame with this epoch and sequence that this gateway sent to the barrier on another path.
    pub fn also_sent(&mut self, frame: (u16, u16)) {
        if let Kind::Barrier(link) = &mut self.kind {
            link.also_sent(frame);
        }
    }

    /// Records a sent correction (mm, rad). `ok`: the write had no error. A failed write may still have arrived, except
    /// on digital lines, where a failed write has no effect.
    pub fn sent(&mut self, now: Duration, values: &PerChannel<f64>, ok: bool) {
        match &mut self.kind {
            Kind::Echo(echo) => echo.sent(now, values),
            Kind::NoReadBack(lines) => lines.sent(now, values, ok, &mut self.status),
            Kind::Barrier(_) => {}
        }
        let is_unseen = !self.observes_arrival();
        self.arrivals.sent(now, ok, is_unseen);
        self.update_status();
    }

    /// Restores the output of the last run, written `age` ago, for controls without read-back.
    pub fn restore(
        &mut self,
        now: Duration,
        values: &PerChannel<f64>,
        age: Duration,
        limits: &Limits,
    ) {
        if let Kind::NoReadBack(lines) = &mut self.kind {
            lines.restore(now, values, age, limits, &mut self.status);
        }
        self.update_status();
    }

    /// Makes this path the active one in place of another path. `released`: the other path led to the barrier of the
    /// same control, which has removed all corrections.
    /// - With a barrier, nothing changes.
    /// - With a read-back but no barrier, the applied correction is unknown until it is read again, because earlier
    ///   readings may be older than the last write of the other path.
    /// - Without a read-back, call this only after the correction of the other path has been removed. A correction that
    ///   this path has written is still treated as applied, unless `released` is set or the control has timed out
    ///   since.
    pub fn take_over(&mut self, now: Duration, released: bool) {
        match &mut self.kind {
            Kind::NoReadBack(lines) => lines.take_over(now, released, &mut self.status),
            Kind::Echo(echo) => echo.take_over(now, &mut self.status),
            Kind::Barrier(_) => return,
        }
        self.arrivals = ArrivalMonitor::default();
        self.update_status();
    }

    /// Records that the operator has verified that a control without read-back applies no
    /// correction.
    pub fn acknowledge(&mut self, now: Duration) {
        if let Kind::NoReadBack(lines) = &mut self.kind {
            lines.acknowledge(now, &mut self.status);
        }
        self.update_status();
    }

    /// Maximum time from the last write until the control has ramped to zero automatically, from any correction; `None`
    /// if the control never does so, or if its ramp is unknown.
    #[must_use]
    pub fn zero_after_last_write(&self, limits: &Limits) -> Option<Duration> {
        match &self.kind {
            Kind::Barrier(link) => link.zero_after_last_write(limits),
            Kind::NoReadBack(lines) => lines.zero_after_last_write(limits),
            Kind::Echo(_) => None,
        }
    }
}
