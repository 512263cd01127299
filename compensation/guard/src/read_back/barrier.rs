//! A control with a barrier: one complete, new report confirms its correction. A frame has arrived when a report shows
//! its sequence.

use core::{ops::RangeInclusive, time::Duration};

use volcomp_vocabulary::PerChannel;

use super::status::{Arrival, BarrierMisfit, Confirmed, ReadBackStatus};
use crate::{
    Limits, Reasons,
    barrier::{FRAME_WORDS, Report, Settings},
    protocol::{Counts, Layout, ReportStatus, Session},
    step::ROUNDING,
};

/// Interval over which the control's scans are compared with the clock.
const COUNTED: Duration = Duration::from_secs(1);
/// Gap between two reports over which scans are not counted, and after which any tick is accepted as new: the 16-bit
/// tick may have wrapped.
const GAP: Duration = Duration::from_secs(5);

/// The path to a barrier. State: the session, and the scan rate of the control.
///
/// Invariants:
/// - `can_send` and `held_by_other` exclude each other, and both follow from the last new report.
/// - `stands` is the applied correction in all new reports since its time: the barrier accepted another goal but has
///   not moved.
/// - `counted` scans passed since `counted_from`, in one epoch and without a gap.
#[derive(Clone, Debug)]
pub struct BarrierLink {
    session: Session,
    machine: u16,
    layout: Layout,
    scan: Duration,
    settings: Option<Settings>,
    /// Time at which the last report was valid, also if that report was not new.
    last_received: Option<Duration>,
    /// Last new report: the time at which it was valid, its epoch and its tick.
    last: Option<(Duration, u16, u16)>,
    counted_from: Option<Duration>,
    counted: u32,
    /// Whether the scan period is as configured; `None`: not measured long enough.
    scans_fit: Option<bool>,
    /// The last measured scan period; zero before the first measurement.
    scan_counted: Duration,
    last_sent: Option<Counts>,
    /// The correction at which the control has stopped although it accepted another correction, and the time since
    /// which it has stopped.
    stands: Option<(Counts, Duration)>,
    held_by_other: bool,
    can_send: bool,
    /// Whether received words were not a report of this machine and these axes.
    is_foreign_report: bool,
}

impl BarrierLink {
    /// A path to the barrier of the machine with this number and these axes, with a scan period of `scan`. `owner` is a new random number at each
    /// start of the gateway; all paths of one gateway to one barrier share it.
    #[must_use]
    pub fn new(owner: u16, machine: u16, layout: Layout, scan: Duration) -> Self {
        Self {
            session: Session::new(owner),
            machine,
            layout,
            scan,
            settings: None,
            last_received: None,
            last: None,
            counted_from: None,
            counted: 0,
            scans_fit: None,
            scan_counted: Duration::ZERO,
            last_sent: None,
            stands: None,
            held_by_other: false,
            can_send: false,
            is_foreign_report: false,
        }
    }

    pub(super) fn receive(
        &mut self,
        taken: Duration,
        words: &[u16],
        limits: &Limits,
        status: &mut ReadBackStatus,
    ) -> Arrival {
        let report = Report::decode(self.machine, self.layout, words);
        self.is_foreign_report = report.is_none();
        let Some(report) = report.filter(|_| self.layout.count() == limits.count) else {
            // The report is torn, or belongs to another machine or other axes.
            return Arrival::Unknown;
        };
        // Reports of a stopped program also arrive, but are not new.
        let last_received = self.last_received.replace(taken);
        if last_received.is_some_and(|then| taken.saturating_sub(then) >= GAP) {
            self.session.forget();
        }
        let seen = self.session.read(report.head());
        if seen == ReportStatus::Old {
            return Arrival::Unknown;
        }
        self.count(taken, report.epoch, report.tick);
        self.settings = Some(report.settings);
        status.confirmed =
            Some(Confirmed { values: values_of(&report.applied, limits), at: taken });
        let ReportStatus::Confirmed { landed, epoch_began } = seen else {
            (self.held_by_other, self.can_send) = (true, false);
            self.stands = None;
            status.changed = true;
            return Arrival::Unknown;
        };
        // The epoch also counts as new in the first report after a report with another owner.
        status.changed = epoch_began;
        (self.held_by_other, self.can_send) = (false, true);
        self.stands = match self.stands {
            _ if epoch_began || self.last_sent == Some(report.applied) => None,
            Some((at, since)) if at == report.applied => Some((at, since)),
            _ => landed.then_some((report.applied, taken)),
        };
        if landed || epoch_began { Arrival::All } else { Arrival::Unknown }
    }

    /// Time until a movement of the control is reported: the frame must arrive, be accepted, and move the axis by one
    /// step, and the report must arrive.
    fn motion_delay(&self, limits: &Limits) -> Duration {
        let step_scans = self.settings.map_or(0, |settings| settings.step_scans);
        limits.longest_delay() + self.time_of(step_scans)
    }

    /// Counts the control's scans. A new epoch restarts the count, because the control may have been switched on.
    fn count(&mut self, taken: Duration, epoch: u16, tick: u16) {
        let before = self.last.replace((taken, epoch, tick));
        let goes_on = |(then, of, _): &(Duration, u16, u16)| {
            *of == epoch && taken.saturating_sub(*then) < GAP
        };
        let Some((then, _, before)) = before.filter(goes_on) else {
            (self.counted_from, self.counted) = (Some(taken), 0);
            return;
        };
        self.counted += u32::from(tick.wrapping_sub(before));
        let from = *self.counted_from.get_or_insert(then);
        let passed = taken.saturating_sub(from);
        if passed >= COUNTED {
            self.scans_fit = Some(scans_fit(self.counted, passed, self.scan));
            self.scan_counted = passed / self.counted.max(1);
            (self.counted_from, self.counted) = (Some(taken), 0);
        }
    }

    pub(super) fn judge(&self, now: Duration, limits: &Limits, status: &mut ReadBackStatus) {
        let hold = self.settings.map(|settings| self.time_of(settings.hold_scans));
        let age = status.confirmed.map(|confirmed| now.saturating_sub(confirmed.at));
        status.motion_delay = self.motion_delay(limits);
        // Time from which the control could have moved, delayed by the age of the last report.
        status.stationary_since = age
            .zip(self.stands)
            .map(|(age, (_, since))| since.saturating_add(status.motion_delay).saturating_add(age));
        status.barrier_time_out =
            (self.settings).map(|settings| self.time_of(settings.time_out_scans));
        // A frame that answers an older report would be rejected.
        status.writable = self.can_send && hold.zip(age).is_some_and(|(hold, age)| age < hold);
        let settings = self.settings;
        let of_settings = settings.and_then(|of| barrier_misfits(&of, self.scan, limits).next());
        let of_scans = (self.scans_fit == Some(false))
            .then_some(BarrierMisfit::ScanPeriod { found: self.scan_counted, expected: self.scan });
        status.barrier_misfit = of_settings.or(of_scans);
        status.reasons = Reasons::OTHER_GATEWAY.when(self.held_by_other)
            | Reasons::BARRIER_UNFIT.when(status.barrier_misfit.is_some())
            | Reasons::BARRIER_STRANGE.when(self.is_foreign_report && self.settings.is_none())
            | Reasons::WATCHING.when(self.settings.is_some() && self.scans_fit.is_none());
    }

    fn time_of(&self, scans: u16) -> Duration {
        self.scan.saturating_mul(u32::from(scans))
    }

    pub(super) fn frame(
        &mut self,
        values: &PerChannel<f64>,
        limits: &Limits,
        words: &mut [u16; FRAME_WORDS],
    ) -> Option<usize> {
        let settings = self.settings.filter(|_| self.can_send)?;
        let counts = counts_of(values, limits)?;
        let frame = self.session.frame(&counts)?;
        self.last_sent = Some(counts);
        Some(frame.encode(&settings, words))
    }

    pub(super) fn last_frame(&self) -> Option<(u16, u16)> {
        self.session.sent
    }

    pub(super) fn also_sent(&mut self, (epoch, sequence): (u16, u16)) {
        self.session.sends(epoch, sequence);
    }

    /// Time to zero with the maximum accepted scan period, and the delay of the path for the last frame.
    pub(super) fn zero_after_last_write(&self, limits: &Limits) -> Option<Duration> {
        let settings = self.settings?;
        let steps = |i: usize| {
            let (limit, rate) = (settings.limit[i], settings.rate[i].max(1));
            limit.unsigned_abs().div_ceil(rate.unsigned_abs())
        };
        let most = u32::from(limits.places().map(steps).max().unwrap_or(0));
        let waits = u32::from(settings.hold_scans) + u32::from(settings.time_out_scans);
        // A step begins at most one step period late.
        let moves = u32::from(settings.step_scans) * (most + 1);
        let scans = longest_scan(self.scan).saturating_mul(waits + moves);
        Some(scans.saturating_add(limits.longest_delay()))
    }
}

fn values_of(counts: &Counts, limits: &Limits) -> PerChannel<f64> {
    PerChannel::from_fn(|i| {
        if i < limits.count { f64::from(counts[i]) * limits.axes[i].resolution } else { 0.0 }
    })
}

/// Converts mm and rad to counts of each axis; `None` if a count does not fit into a word.
#[expect(clippy::cast_possible_truncation, reason = "the range of a word was checked before")]
fn counts_of(values: &PerChannel<f64>, limits: &Limits) -> Option<Counts> {
    let mut counts = Counts::default();
    for i in limits.places() {
        let count = libm::round(values[i] / limits.axes[i].resolution);
        if !(f64::from(-i16::MAX)..=f64::from(i16::MAX)).contains(&count) {
            return None;
        }
        counts[i] = count as i16;
    }
    Some(counts)
}

/// Accepted ratio of the measured scan period to the configured one.
const SCAN_WITHIN: RangeInclusive<f64> = 0.8..=1.25;
/// Minimum ratio of the barrier's rate to the guard's slew, so that the barrier can follow the guard.
pub const RATE_OVER_SLEW: f64 = 2.0;

/// Settings of a barrier, with a scan period of `scan`, that do not fit the limits. A barrier fits if it passes every
/// correction of the guard, can follow it, and times out early enough.
pub fn barrier_misfits(
    settings: &Settings,
    scan: Duration,
    limits: &Limits,
) -> impl Iterator<Item = BarrierMisfit> {
    let step_s = scan.saturating_mul(u32::from(settings.step_scans)).as_secs_f64();
    let time_out = scan.saturating_mul(u32::from(settings.time_out_scans));
    let zero_after = limits.zero_after;
    let late = (time_out > zero_after)
        .then_some(BarrierMisfit::TimeOut { found: time_out, expected: zero_after });
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

fn longest_scan(scan: Duration) -> Duration {
    Duration::try_from_secs_f64(scan.as_secs_f64() / SCAN_WITHIN.start()).unwrap_or(Duration::MAX)
}

/// Whether this number of scans in this time fits a scan period of `scan`.
#[must_use]
pub fn scans_fit(scans: u32, passed: Duration, scan: Duration) -> bool {
    let expected = scan.as_secs_f64() * f64::from(scans);
    SCAN_WITHIN.contains(&(expected / passed.as_secs_f64()))
}
