//! Whether what was sent has landed: the one place that says so.

use core::time::Duration;

use crate::Limits;

/// What a reading says of what was sent.
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
    /// When the control was asked last, and when something was sent to it last.
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

    /// The control was asked, and said this of what was sent.
    pub(super) fn hear(&mut self, now: Duration, answered: bool, landed: Landed, limits: &Limits) {
        let before = self.heard.replace(now).unwrap_or(now);
        match landed {
            Landed::Unknown => {}
            Landed::All => self.since = None,
            Landed::Before(since) => self.since = Some(since),
        }
        if !answered {
            // Whether it has landed nobody could see meanwhile.
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
    /// where it asked for what the control applies anyway.
    pub(super) fn unlanded_since(&self) -> Option<Duration> {
        match (self.since, self.failing_since) {
            (Some(since), Some(failing)) => Some(since.min(failing)),
            (since, failing) => since.or(failing),
        }
    }
}
