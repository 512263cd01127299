//! Knowledge of the correction that a control applies.
//!
//! A received value is not used before it is confirmed, and a sent correction is not considered applied before it is read back. The method
//! depends on the control: a [`barrier`](crate::barrier), words that can be read back, or neither.
//!
//! With a barrier, one complete, new report confirms the correction. A frame has arrived when a report shows its sequence.
//!
//! Without a barrier a single reading does not confirm a value: it may be torn, late, or of another axis. Therefore all values that may
//! be applied are stored: the last confirmed value, and the values sent since. A reading that equals one of them on all
//! axes confirms that value, and excludes the values sent before it. Any other reading may be old, and nothing is sent
//! in response. A foreign value is accepted only after a pause in sending that is longer than the age of any reading,
//! and after three consecutive readings, one path delay apart. A message that a driver repeats with each new position
//! is one reading.
//!
//! If a control whose correction cannot be read back, such as a control with digital lines, reports its output levels, the
//! correction on them is treated as applied, like a read-back. Otherwise every write without an error is treated as applied.

use core::{ops::RangeInclusive, time::Duration};

use volcomp_vocabulary::PerChannel;

use crate::{
    Limits, Reasons,
    barrier::{FRAME_WORDS, Report, Settings},
    limits::MOST_READ_BACK_CYCLES,
    protocol::{Counts, Layout, ReportStatus, Session},
    step::{ROUNDING, is_same_step},
};

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
enum Arrival {
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
struct ArrivalMonitor {
    last_received: Option<Duration>,
    sent: Option<Duration>,
    /// Time from which a sent correction has not arrived; `None`: all have arrived.
    since: Option<Duration>,
    /// Time from which every write has failed; `None`: the last write succeeded.
    failing_since: Option<Duration>,
}

impl ArrivalMonitor {
    /// Records a write; `ok`: the write had no error. `is_unseen`: a write without an error is treated as applied.
    fn sent(&mut self, now: Duration, ok: bool, is_unseen: bool) {
        self.sent = Some(now);
        self.failing_since = (!ok).then(|| self.failing_since.unwrap_or(now));
        self.since = if ok && is_unseen { None } else { self.since.or(Some(now)) };
    }

    fn receive(&mut self, now: Duration, answered: bool, landed: Arrival, limits: &Limits) {
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
    fn unlanded_since(&self) -> Option<Duration> {
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

    fn receive(
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

    fn judge(&self, now: Duration, limits: &Limits, status: &mut ReadBackStatus) {
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

    fn frame(
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

    fn last_frame(&self) -> Option<(u16, u16)> {
        self.session.sent
    }

    fn also_sent(&mut self, (epoch, sequence): (u16, u16)) {
        self.session.sends(epoch, sequence);
    }

    /// Time to zero with the maximum accepted scan period, and the delay of the path for the last frame.
    fn zero_after_last_write(&self, limits: &Limits) -> Option<Duration> {
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

/// Number of consecutive equal readings that confirm a foreign value.
const EQUAL_READINGS: u32 = 3;
const OTHER_REPORTED_FOR: Duration = Duration::from_secs(5);
/// Capacity: more than the confirmed value and one write for each cycle of the maximum read-back lag.
const MOST: usize = MOST_READ_BACK_CYCLES + 4;

/// A correction that may be applied, and when it was first sent.
#[derive(Clone, Copy, Debug, Default)]
struct Candidate {
    since: Duration,
    values: PerChannel<f64>,
}

#[derive(Clone, Copy, Debug)]
struct Equal {
    values: PerChannel<f64>,
    readings: u32,
    taken: Duration,
}

/// The values of one path that may be applied.
///
/// Invariants:
/// - `candidates[..count]` are in the order of sending, and consecutive candidates differ. With a `count` of 0 the
///   applied correction is unknown, and nothing is sent.
/// - After a confirmation the first candidate is the confirmed correction; the later candidates were sent after it.
/// - `equal` counts only readings that are later than every write by more than the maximum age of a reading.
#[derive(Clone, Debug)]
struct Echo {
    /// Time before the first write during which the values must not change.
    watch: Duration,
    /// Values that may be applied, oldest first: the confirmed value, and the values sent since. Consecutive equal
    /// values are merged.
    candidates: [Candidate; MOST],
    count: usize,
    last_received: Option<Duration>,
    /// Consecutive equal readings that are later than every write: their value, their number, and the time at which the
    /// last counted reading was valid.
    equal: Option<Equal>,
    /// Time of the last write on any path.
    sent: Option<Duration>,
    /// Whether this path has sent a value since the start, or since a foreign value was last confirmed.
    has_sent: bool,
    /// Time since which only this gateway has changed the values.
    alone_since: Option<Duration>,
    other: Option<Duration>,
}

impl Echo {
    fn new(watch: Duration) -> Self {
        Self {
            watch,
            candidates: [Candidate::default(); MOST],
            count: 0,
            last_received: None,
            equal: None,
            sent: None,
            has_sent: false,
            alone_since: None,
            other: None,
        }
    }

    fn receive(
        &mut self,
        now: Duration,
        taken: Duration,
        values: &PerChannel<f64>,
        limits: &Limits,
        status: &mut ReadBackStatus,
    ) -> Arrival {
        if !limits.places().all(|i| values[i].is_finite()) {
            status.writable = false;
            self.equal = None;
            return Arrival::Unknown;
        }
        if self.last_received.replace(taken) == Some(taken) {
            // The driver has repeated the previous message, which is ignored.
            return Arrival::Unknown;
        }
        let found = self.find(values, taken, limits);
        let is_same = self.count_equal(values, taken, limits);
        if found.is_none() && is_same == Some(false) && !self.has_sent {
            // Another sender changes the values.
            self.alone_since = Some(now);
        }
        if self.equal.is_some_and(|equal| equal.readings >= EQUAL_READINGS) {
            // All earlier writes are obsolete.
            status.changed = found.is_none();
            self.has_sent &= found.is_some();
            self.begin(values, now);
            self.confirm(values, [taken, now], status);
            return Arrival::All;
        }
        let Some([oldest, newest]) = found else {
            status.writable = false;
            return Arrival::Unknown;
        };
        let landed = match self.candidates[..self.count].get(newest + 1) {
            Some(next) => Arrival::Before(next.since),
            None => Arrival::All,
        };
        self.candidates.copy_within(oldest..self.count, 0);
        self.count -= oldest;
        self.confirm(values, [taken, now], status);
        landed
    }

    /// Counts equal readings. Returns whether this reading equals the previous one; `None` if it may be from before the
    /// last write.
    fn count_equal(
        &mut self,
        values: &PerChannel<f64>,
        taken: Duration,
        limits: &Limits,
    ) -> Option<bool> {
        let since = |then: Duration| taken.saturating_sub(then);
        let is_quiet = |sent| since(sent) > limits.oldest_reading();
        let before = self.equal.take();
        if !self.sent.is_none_or(is_quiet) {
            return None;
        }
        let same = before.filter(|before| are_equal(&before.values, values, limits));
        let mut equal = same.unwrap_or(Equal { values: *values, readings: 0, taken });
        if same.is_none_or(|before| since(before.taken) >= limits.delay()) {
            equal.readings = equal.readings.saturating_add(1);
            equal.taken = taken;
        }
        self.equal = Some(equal);
        Some(same.is_some())
    }

    fn begin(&mut self, values: &PerChannel<f64>, now: Duration) {
        self.candidates[0] = Candidate { since: now, values: *values };
        self.count = 1;
    }

    /// Records that a reading received now confirms these values at `taken`.
    fn confirm(
        &mut self,
        values: &PerChannel<f64>,
        [taken, now]: [Duration; 2],
        status: &mut ReadBackStatus,
    ) {
        self.alone_since.get_or_insert(now);
        status.confirmed = Some(Confirmed { values: *values, at: taken });
        // If the list of candidates is full, nothing more may be sent.
        status.writable = self.count < MOST;
    }

    /// The oldest and the newest candidate that a reading may show; `None` if the reading equals no candidate.
    ///
    /// A candidate whose successor was sent longer ago than the path's delay is possible only if the successor did not
    /// arrive. Therefore it is the oldest match only if no later candidate has the same values.
    fn find(
        &self,
        values: &PerChannel<f64>,
        taken: Duration,
        limits: &Limits,
    ) -> Option<[usize; 2]> {
        let candidates = &self.candidates[..self.count];
        let is_it = |place: &usize| are_equal(&candidates[*place].values, values, limits);
        let may_stand = |place: &usize| {
            let next = candidates.get(place + 1);
            next.is_none_or(|next| taken.saturating_sub(next.since) <= limits.longest_delay())
        };
        let newest = (0..self.count).rev().find(is_it)?;
        let oldest = (0..=newest).filter(is_it).find(may_stand);
        Some([oldest.unwrap_or(newest), newest])
    }

    fn sent(&mut self, now: Duration, values: &PerChannel<f64>) {
        self.sent = Some(now);
        self.has_sent = true;
        let last = self.count.checked_sub(1).map(|last| self.candidates[last]);
        if last.is_some_and(|last| last.values == *values) {
            return;
        }
        if self.count == MOST {
            // A value was sent although nothing may be sent: the applied correction is unknown.
            self.count = 0;
            return;
        }
        self.candidates[self.count] = Candidate { since: now, values: *values };
        self.count += 1;
    }

    /// Makes this path the active one. The applied correction becomes unknown, because values sent on the previous path may be applied.
    fn take_over(&mut self, now: Duration, status: &mut ReadBackStatus) {
        self.sent = self.sent.max(Some(now));
        (self.count, self.equal, status.writable) = (0, None, false);
        // Changes seen during standby were made by this gateway.
        self.alone_since = Some(Duration::ZERO);
    }

    /// The lowest and the highest value of each axis that may be applied.
    fn between(&self) -> Option<[PerChannel<f64>; 2]> {
        let (first, others) = self.candidates[..self.count].split_first()?;
        let mut between = [first.values; 2];
        let [lowest, highest] = &mut between;
        for other in others {
            for (i, value) in other.values.iter().enumerate() {
                lowest[i] = lowest[i].min(*value);
                highest[i] = highest[i].max(*value);
            }
        }
        Some(between)
    }

    fn report_other_gateway(&mut self, now: Duration) {
        self.other = Some(now);
        self.alone_since = Some(now);
    }

    fn judge(&self, now: Duration, limits: &Limits, status: &mut ReadBackStatus) {
        let fresh = status
            .confirmed
            .is_some_and(|confirmed| now.saturating_sub(confirmed.at) <= limits.delay());
        let still = self.alone_since.is_some_and(|since| now.saturating_sub(since) >= self.watch);
        // Before the first write, only this gateway may have changed the values, and no reading may be from the
        // previous run.
        let alone = still || self.has_sent;
        status.writable &= fresh && alone;
        let other = self.other.is_some_and(|seen| now.saturating_sub(seen) < OTHER_REPORTED_FOR);
        status.reasons = Reasons::WATCHING.when(!alone)
            | Reasons::OTHER_GATEWAY.when(other)
            | Reasons::NO_BARRIER;
    }
}

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
struct NoReadBack {
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
    fn new(control: Option<ControlTimeOut>) -> Self {
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

    fn has_reported(&self) -> bool {
        self.has_reported
    }

    fn reports_now(&self) -> bool {
        self.reports_now
    }

    /// Range of the values that each axis may apply; `None` while the device does not report its outputs.
    fn between(&self) -> Option<[PerChannel<f64>; 2]> {
        self.echo.between().filter(|_| self.reports_now)
    }

    fn receive(
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
    fn sent(
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
    fn restore(
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
    fn take_over(&mut self, now: Duration, released: bool, status: &mut ReadBackStatus) {
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

    fn acknowledge(&mut self, now: Duration, status: &mut ReadBackStatus) {
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

    fn zero_after_last_write(&self, limits: &Limits) -> Option<Duration> {
        // The last write may have been in transit for one cycle.
        self.control.map(|control| control.all().saturating_add(limits.period))
    }
}
