//! A control with a barrier: one whole reading that moved on is confirmed, and a frame has landed when its sequence is
//! echoed.

use core::{ops::RangeInclusive, time::Duration};

use volcomp_vocabulary::PerChannel;

use super::known::{Confirmed, Known, Landed};
use crate::{
    Limits, Reasons,
    barrier::{FRAME_WORDS, Report, Settings},
    protocol::{Counts, Layout, Seen, Session},
    step::ROUNDING,
};

/// The stretch over which the control's scans are counted against the clock.
const COUNTED: Duration = Duration::from_secs(1);
/// A gap between two reports over which scans are not counted, and after which any tick is new: its 16 bits may have gone
/// round.
const GAP: Duration = Duration::from_secs(5);

/// The path to a barrier. State: the session, and how fast the control scans.
#[derive(Clone, Debug)]
pub struct BarrierLink {
    session: Session,
    machine: u16,
    layout: Layout,
    scan: Duration,
    settings: Option<Settings>,
    /// When the last report held, whether it was a new one or not.
    heard: Option<Duration>,
    /// When the last new report held, its epoch and tick, and the scans since `counted_from`.
    last: Option<(Duration, u16, u16)>,
    counted_from: Option<Duration>,
    counted: u32,
    /// Whether the time of a scan is as configured; `None`: not counted for long enough.
    scans_fit: Option<bool>,
    /// What was sent last.
    asked: Option<Counts>,
    /// Where the control stands although it took what was sent, which is another value, and since when it does.
    stands: Option<(Counts, Duration)>,
    held_by_other: bool,
    can_send: bool,
    /// Whether words came as a report that were none of this machine and these axes.
    strange: bool,
}

impl BarrierLink {
    /// A way to the barrier of the machine with this number and of these axes, whose control scans once in `scan`. `owner`
    /// is drawn anew at each start of the gateway; all ways of one gateway to one barrier have the same.
    #[must_use]
    pub fn new(owner: u16, machine: u16, layout: Layout, scan: Duration) -> Self {
        Self {
            session: Session::new(owner),
            machine,
            layout,
            scan,
            settings: None,
            heard: None,
            last: None,
            counted_from: None,
            counted: 0,
            scans_fit: None,
            asked: None,
            stands: None,
            held_by_other: false,
            can_send: false,
            strange: false,
        }
    }

    pub(super) fn hear(
        &mut self,
        taken: Duration,
        words: &[u16],
        limits: &Limits,
        known: &mut Known,
    ) -> Landed {
        let report = Report::decode(self.machine, self.layout, words);
        self.strange = report.is_none();
        let Some(report) = report.filter(|_| self.layout.count() == limits.count) else {
            // Torn, or of another machine or other axes: it says nothing.
            return Landed::Unknown;
        };
        // Reports of a program that stands come as well, and are not new.
        let heard = self.heard.replace(taken);
        if heard.is_some_and(|then| taken.saturating_sub(then) >= GAP) {
            self.session.forget();
        }
        let seen = self.session.read(report.head());
        if seen == Seen::Old {
            return Landed::Unknown;
        }
        self.count(taken, report.epoch, report.tick);
        self.settings = Some(report.settings);
        known.confirmed = Some(Confirmed {
            values: values_of(&report.applied, limits),
            at: taken,
        });
        let Seen::Confirmed {
            landed,
            epoch_began,
        } = seen
        else {
            (self.held_by_other, self.can_send) = (true, false);
            self.stands = None;
            known.changed = true;
            return Landed::Unknown;
        };
        // The first report after another's is a new beginning, too.
        known.changed = epoch_began;
        (self.held_by_other, self.can_send) = (false, true);
        self.stands = match self.stands {
            _ if epoch_began || self.asked == Some(report.applied) => None,
            Some((at, since)) if at == report.applied => Some((at, since)),
            _ => landed.then_some((report.applied, taken)),
        };
        if landed || epoch_began {
            Landed::All
        } else {
            Landed::Unknown
        }
    }

    /// How long after the control can move it is seen to: what was sent has to go there, to be taken, to move it by a step, and
    /// to be reported.
    fn shown_after(&self, limits: &Limits) -> Duration {
        let step_scans = self.settings.map_or(0, |settings| settings.step_scans);
        limits.longest_delay() + self.time_of(step_scans)
    }

    /// Counts the control's scans. With a new epoch they may begin anew: the control was switched on.
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
            (self.counted_from, self.counted) = (Some(taken), 0);
        }
    }

    pub(super) fn judge(&self, now: Duration, limits: &Limits, known: &mut Known) {
        let hold = self
            .settings
            .map(|settings| self.time_of(settings.hold_scans));
        let age = known
            .confirmed
            .map(|confirmed| now.saturating_sub(confirmed.at));
        known.shown_after = self.shown_after(limits);
        // As of when it could have moved, by the last report, which is so old.
        known.stands_since = age
            .zip(self.stands)
            .map(|(age, (_, since))| since.saturating_add(known.shown_after).saturating_add(age));
        known.lets_go_after = (self.settings).map(|settings| self.time_of(settings.time_out_scans));
        // A frame that answers an older report is refused.
        known.writable = self.can_send && hold.zip(age).is_some_and(|(hold, age)| age < hold);
        let fits = self.settings.is_some_and(|settings| {
            barrier_misfits(&settings, self.scan, limits)
                .next()
                .is_none()
        });
        known.reasons = Reasons::OTHER_GATEWAY.when(self.held_by_other)
            | Reasons::BARRIER_UNFIT
                .when(self.settings.is_some() && !fits || self.scans_fit == Some(false))
            | Reasons::BARRIER_STRANGE.when(self.strange && self.settings.is_none())
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
        self.asked = Some(counts);
        Some(frame.encode(&settings, words))
    }

    /// Epoch and sequence of the last frame.
    pub(super) fn last_frame(&self) -> Option<(u16, u16)> {
        self.session.sent
    }

    /// A frame of this gateway went by another path.
    pub(super) fn also_sent(&mut self, (epoch, sequence): (u16, u16)) {
        self.session.sends(epoch, sequence);
    }

    /// The scans may take as long as is accepted, and the last frame as long as the path.
    pub(super) fn zero_by_itself(&self, limits: &Limits) -> Option<Duration> {
        let settings = self.settings?;
        let steps = |i: usize| {
            let (limit, rate) = (settings.limit[i], settings.rate[i].max(1));
            limit.unsigned_abs().div_ceil(rate.unsigned_abs())
        };
        let most = u32::from(limits.places().map(steps).max().unwrap_or(0));
        let waits = u32::from(settings.hold_scans) + u32::from(settings.time_out_scans);
        // A step is begun at most one step's scans late.
        let moves = u32::from(settings.step_scans) * (most + 1);
        let scans = longest_scan(self.scan).saturating_mul(waits + moves);
        Some(scans.saturating_add(limits.longest_delay()))
    }
}

/// Counts of each axis as mm and rad.
fn values_of(counts: &Counts, limits: &Limits) -> PerChannel<f64> {
    PerChannel::from_fn(|i| {
        if i < limits.count {
            f64::from(counts[i]) * limits.axes[i].resolution
        } else {
            0.0
        }
    })
}

/// mm and rad as counts of each axis; `None` where a count does not fit into a word.
#[expect(
    clippy::cast_possible_truncation,
    reason = "the range of a word was looked at before"
)]
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

/// How far the time of a scan may be from the configured one.
const SCAN_WITHIN: RangeInclusive<f64> = 0.8..=1.25;
/// The minimum ratio of the rate of the barrier to the slew of the guard, so that it follows.
pub const RATE_OVER_SLEW: f64 = 2.0;

/// A setting of a barrier that does not fit the limits of the guard: what was found, and the least or the most that fits. Axes
/// are counted from 0, in channel order.
#[expect(missing_docs, reason = "found and expected")]
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BarrierMisfit {
    /// The barrier lets less through than the guard may send, mm or rad.
    Limit {
        axis: usize,
        found: f64,
        expected: f64,
    },
    /// The barrier moves less than twice as fast as the guard, mm or rad in a second.
    Rate {
        axis: usize,
        found: f64,
        expected: f64,
    },
    /// The barrier waits longer for a frame than the guard waits until it ramps out (`zero_after`).
    TimeOut { found: Duration, expected: Duration },
}

/// Every setting of a barrier, whose control scans once in `scan`, that does not fit the limits: it has to let through what
/// the guard may send, to follow it, and to time out early enough.
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
fn longest_scan(scan: Duration) -> Duration {
    Duration::try_from_secs_f64(scan.as_secs_f64() / SCAN_WITHIN.start()).unwrap_or(Duration::MAX)
}

/// Whether this number of scans in this time is that of a control that scans once in `scan`.
#[must_use]
pub fn scans_fit(scans: u32, passed: Duration, scan: Duration) -> bool {
    let expected = scan.as_secs_f64() * f64::from(scans);
    SCAN_WITHIN.contains(&(expected / passed.as_secs_f64()))
}
