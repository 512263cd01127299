//! A control whose correction cannot be read back, such as a control with digital lines. If the device reports its
//! output levels, the correction on them is treated as applied, like a read-back. Otherwise every write without an
//! error is treated as applied.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use super::{
    echo::Echo,
    status::{Arrival, Confirmed, CorrectionReport, ReadBackStatus, are_equal},
};
use crate::{Limits, Reasons};

/// Behaviour of a control without read-back when writes stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlTimeOut {
    /// Time without a write after which the control starts to ramp to zero.
    pub after: Duration,
    /// Time of the control's ramp from its largest correction to zero.
    pub to_zero: Duration,
}

impl ControlTimeOut {
    fn all(&self) -> Duration {
        self.after.saturating_add(self.to_zero)
    }
}

/// A control without read-back; its correction is derived from the writes.
///
/// Invariants:
/// - `reports_now` implies `has_reported`.
/// - `acts` is in order of time, and is set only if the control ramps to zero automatically.
/// - While `unknown` is set, nothing is written. It is cleared by a reading that confirms a correction, at the time
///   when the control must be at zero, or by an acknowledgement.
#[derive(Clone, Debug)]
#[expect(clippy::struct_excessive_bools, reason = "five separate facts")]
pub(super) struct NoReadBack {
    control: Option<ControlTimeOut>,
    /// Times at which, without another write, the control may start its ramp and must be at zero.
    acts: Option<[Duration; 2]>,
    last_received: Option<Duration>,
    unknown: bool,
    echo: Echo,
    /// Whether the device has ever reported its output levels.
    has_reported: bool,
    /// Whether the device has reported its output levels in this cycle.
    reports_now: bool,
    has_written: bool,
    acknowledged: bool,
}

impl NoReadBack {
    pub(super) fn new(control: Option<ControlTimeOut>) -> Self {
        Self {
            control,
            acts: None,
            last_received: None,
            unknown: false,
            echo: Echo::new(Duration::ZERO),
            has_reported: false,
            reports_now: false,
            has_written: false,
            acknowledged: false,
        }
    }

    pub(super) fn has_reported(&self) -> bool {
        self.has_reported
    }

    pub(super) fn reports_now(&self) -> bool {
        self.reports_now
    }

    /// Range of the values that each axis may apply; `None` while the device does not report its outputs.
    pub(super) fn between(&self) -> Option<[PerChannel<f64>; 2]> {
        self.echo.between().filter(|_| self.reports_now)
    }

    pub(super) fn receive(
        &mut self,
        now: Duration,
        taken: Duration,
        report: &CorrectionReport<'_>,
        limits: &Limits,
        status: &mut ReadBackStatus,
    ) -> Arrival {
        self.last_received = Some(now);
        if let Some([acts, at_zero]) = self.acts
            && now >= acts
        {
            // The control is ramping to zero for lack of writes, or is at zero: earlier words, which may still be on
            // its lines, no longer count.
            self.echo = Echo::new(Duration::ZERO);
            let was_zero =
                status.confirmed.is_some_and(|confirmed| confirmed.values == PerChannel::ZERO);
            self.unknown = now < at_zero && !was_zero;
            status.changed = !self.unknown && !was_zero;
            status.confirmed =
                (!self.unknown).then_some(Confirmed { values: PerChannel::ZERO, at: now });
        }
        // If a control ramps to zero automatically, the levels of its lines are valid only while it receives writes.
        let is_on = self.control.is_none()
            || self.has_written && self.acts.is_some_and(|[acts, _]| now < acts);
        let report = match report {
            CorrectionReport::Values(values) if is_on => Some(values),
            _ => None,
        };
        self.has_reported |= report.is_some();
        self.reports_now = report.is_some();
        let landed = report.map_or(Arrival::Unknown, |values| {
            let landed = self.echo.receive(now, taken, values, limits, status);
            self.echo.judge(now, limits, status);
            // A reading that confirms a value also shows which writes have arrived, so the correction is known.
            self.unknown &= landed == Arrival::Unknown;
            landed
        });
        if !self.reports_now {
            self.without_levels(now, status);
        }
        status.control_acts_at = self.acts.map(|[acts, _]| acts).filter(|acts| now < *acts);
        status.reasons = Reasons::NO_BARRIER
            | Reasons::CANNOT_SEE_OTHERS
            | Reasons::LEFT_UNKNOWN.when(self.unknown);
        landed
    }

    /// Without output levels the last write counts, because only this gateway writes the lines. After a device has lost
    /// its reported levels, the correction is known again only after another accepted write.
    fn without_levels(&mut self, now: Duration, status: &mut ReadBackStatus) {
        // If nothing was ever written or restored, the correction is taken as zero.
        if !self.unknown {
            status.confirmed.get_or_insert(Confirmed { values: PerChannel::ZERO, at: now });
        }
        if let Some(confirmed) = status.confirmed.as_mut().filter(|_| !self.has_reported) {
            // Only this gateway changes the correction, so the confirmation does not expire.
            confirmed.at = now;
        }
        status.writable = status.confirmed.is_some() && !self.unknown;
    }

    /// Records a write; `ok`: the device accepted the write.
    pub(super) fn sent(
        &mut self,
        now: Duration,
        values: &PerChannel<f64>,
        ok: bool,
        status: &mut ReadBackStatus,
    ) {
        self.echo.sent(now, values);
        if !ok {
            // If a device stops reporting its outputs and a write fails, their levels are unknown.
            self.unknown |= self.has_reported && !self.reports_now;
            return;
        }
        self.has_written = true;
        // The device may have received the write at the beginning of the cycle, or only now.
        self.wait([self.last_received.unwrap_or(now), now], Duration::ZERO);
        if self.reports_now {
            return;
        }
        status.confirmed = Some(Confirmed { values: *values, at: now });
    }

    /// Starts the control's timeout from a write `age` ago, which was made between the two times.
    fn wait(&mut self, [earliest, latest]: [Duration; 2], age: Duration) {
        self.acts = self.control.map(|control| {
            let to_zero = control.all();
            [
                earliest.saturating_add(control.after.saturating_sub(age)),
                latest.saturating_add(to_zero.saturating_sub(age)),
            ]
        });
    }

    /// Restores the output of the last run. The correction is still applied while the control cannot have timed out,
    /// zero once the control must have ramped to zero, and unknown in between.
    pub(super) fn restore(
        &mut self,
        now: Duration,
        values: &PerChannel<f64>,
        age: Duration,
        limits: &Limits,
        status: &mut ReadBackStatus,
    ) {
        let is_finite = limits.places().all(|i| values[i].is_finite());
        let is_zero = are_equal(values, &PerChannel::ZERO, limits);
        let found = match self.control {
            _ if !is_finite => None,
            _ if is_zero => Some(PerChannel::ZERO),
            None => Some(*values),
            Some(control) if age < control.after => Some(*values),
            Some(control) if age > control.all() => Some(PerChannel::ZERO),
            Some(_) => None,
        };
        self.unknown = found.is_none();
        self.wait([now; 2], age);
        status.confirmed = found.map(|values| Confirmed { values, at: now });
    }

    /// Takes over from another path, whose correction is removed. A correction that this path has written before
    /// remains, unless the control has dropped it (`released`, as by a barrier) or has timed out since the last write.
    pub(super) fn take_over(&mut self, now: Duration, released: bool, status: &mut ReadBackStatus) {
        if self.has_reported {
            // The outputs keep their levels, which are read before the first write.
            self.acts = None;
            self.echo.take_over(now, status);
        } else if released {
            self.acts = None;
            self.set_zero(now, status);
        } else if self.control.is_none() && !self.has_written {
            // The stored correction may have been written by another path in the previous run.
            let zero = |confirmed: Confirmed| confirmed.values == PerChannel::ZERO;
            if self.acknowledged || status.confirmed.is_none_or(zero) && !self.unknown {
                self.set_zero(now, status);
            } else {
                (self.unknown, status.confirmed) = (true, None);
            }
        }
    }

    pub(super) fn acknowledge(&mut self, now: Duration, status: &mut ReadBackStatus) {
        self.acknowledged |= !self.has_written;
        // The correction of a control that ramps to zero is known again once the ramp must be complete.
        if self.unknown && self.acts.is_none() {
            self.set_zero(now, status);
        }
    }

    fn set_zero(&mut self, now: Duration, status: &mut ReadBackStatus) {
        self.unknown = false;
        status.confirmed = Some(Confirmed { values: PerChannel::ZERO, at: now });
    }

    pub(super) fn zero_after_last_write(&self, limits: &Limits) -> Option<Duration> {
        // The last write may have been in transit for one cycle.
        self.control.map(|control| control.all().saturating_add(limits.period))
    }
}
