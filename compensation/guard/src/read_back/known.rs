//! What is known of the correction that a control applies, and whether what was sent has landed.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{Limits, Reasons, step::is_same_step};

/// A correction that the control is known to apply.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Confirmed {
    /// The correction of each axis, mm or rad.
    pub values: PerChannel<f64>,
    /// When it was confirmed last, on the clock of the cycle.
    pub at: Duration,
}

/// What a control reported of the correction that it applies, in one reading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Told<'a> {
    /// It did not answer, or says nothing of corrections.
    Nothing,
    /// The plain values of each axis, mm or rad.
    Values(PerChannel<f64>),
    /// The words of its barrier's report.
    Report(&'a [u16]),
}

/// How the correction of a path is confirmed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Scheme {
    /// A barrier in the control takes frames and reports what it applies.
    Barrier,
    /// Plain values that can be read back.
    #[default]
    Plain,
    /// Plain values that cannot be read back, such as lines.
    NoReadBack,
}

/// What is known of the correction that a control applies.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Known {
    /// How it is confirmed.
    pub scheme: Scheme,
    /// The correction that was confirmed last; `None`: none yet.
    pub confirmed: Option<Confirmed>,
    /// The lowest and the highest correction of each axis that may be applied: what is confirmed, and without a barrier what
    /// was sent since and may have landed, too.
    pub between: [PerChannel<f64>; 2],
    /// Whether the next correction may be written on it: nothing contradicts what was confirmed.
    pub writable: bool,
    /// Whether the confirmed correction is not one that was sent: the control began anew, or something else writes.
    pub changed: bool,
    /// Since when something that was sent has not landed; `None`: all of it has.
    pub unlanded_since: Option<Duration>,
    /// Since when a control with a barrier stands still although it took something else: it holds on its own, and no path shows why.
    /// `None`: it moves, or is where it is to be.
    pub stands_since: Option<Duration>,
    /// How long after a control with a barrier is free to move this is seen at the latest.
    pub shown_after: Duration,
    /// How long after the last frame that it took a barrier times out: what was confirmed longer ago is not
    /// known any more. `None`: no barrier reports it.
    pub lets_go_after: Option<Duration>,
    /// From when on the control may act on its own, on the clock of the cycle: what was decided before is not sent then.
    /// `None`: it does not, or it reports what it does.
    pub until: Option<Duration>,
    /// Why this path may not be armed, and what else is to be known of it.
    pub reasons: Reasons,
}

impl Known {
    /// Whether a correction other than zero is known to be applied.
    #[must_use]
    pub fn holds(&self, limits: &Limits) -> bool {
        self.confirmed
            .is_some_and(|confirmed| !are_equal(&confirmed.values, &PerChannel::ZERO, limits))
    }
}

/// What a reading means for what was sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Landed {
    /// Nothing, or nothing new.
    Unknown,
    /// All of it has landed, or none of it counts any more.
    All,
    /// What was sent from then on has not.
    Before(Duration),
}

/// State: since when something that was sent has not landed.
#[derive(Clone, Debug, Default)]
pub(super) struct Landing {
    /// When the control was read last, and when something was sent to it last.
    heard: Option<Duration>,
    sent: Option<Duration>,
    /// Since when something has not landed; `None`: all of it has.
    since: Option<Duration>,
    /// Since when every write failed; `None`: the last one did not.
    failing_since: Option<Duration>,
}

impl Landing {
    /// Something was sent; `ok`: without a failure. `is_unseen`: what was sent without a failure is taken for applied.
    pub(super) fn sent(&mut self, now: Duration, ok: bool, is_unseen: bool) {
        self.sent = Some(now);
        self.failing_since = (!ok).then(|| self.failing_since.unwrap_or(now));
        self.since = if ok && is_unseen {
            None
        } else {
            self.since.or(Some(now))
        };
    }

    /// The control was read, and this follows for what was sent.
    pub(super) fn hear(&mut self, now: Duration, answered: bool, landed: Landed, limits: &Limits) {
        let before = self.heard.replace(now).unwrap_or(now);
        match landed {
            Landed::Unknown => {}
            Landed::All => self.since = None,
            Landed::Before(since) => self.since = Some(since),
        }
        if !answered {
            // Whether it has landed could not be seen meanwhile.
            let times = [&mut self.since, &mut self.failing_since];
            for since in times.into_iter().flatten() {
                *since += now.saturating_sub(before);
            }
        } else if self
            .sent
            .is_none_or(|sent| now.saturating_sub(sent) > limits.longest_delay())
        {
            // Nothing was sent for so long that what has not landed will not be waited for.
            (self.since, self.failing_since) = (None, None);
        }
    }

    /// Since when something that was sent has not landed; `None`: all of it has. A write that failed has not landed, also
    /// where it had the values that the control applies anyway.
    pub(super) fn unlanded_since(&self) -> Option<Duration> {
        match (self.since, self.failing_since) {
            (Some(since), Some(failing)) => Some(since.min(failing)),
            (since, failing) => since.or(failing),
        }
    }
}

/// Whether two corrections are the same on every axis, to half a step.
pub(crate) fn are_equal(a: &PerChannel<f64>, b: &PerChannel<f64>, limits: &Limits) -> bool {
    limits
        .places()
        .all(|i| is_same_step(a[i], b[i], limits.axes[i].resolution))
}
