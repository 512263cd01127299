//! A control whose correction cannot be read back: what was written successfully is taken for what it applies.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use super::{Confirmed, Known};
use crate::{Limits, Reasons};

/// What a control that cannot be asked does by itself when nothing is written any more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlTimeOut {
    /// Time without a write after which it goes to zero.
    pub after: Duration,
    /// The time that it needs from its largest correction to zero.
    pub to_zero: Duration,
}

#[derive(Clone, Debug)]
pub(super) struct Blind {
    control: Option<ControlTimeOut>,
    /// From when on the control may act by itself, and from when on it is at zero, unless something is written before.
    acts: Option<[Duration; 2]>,
    /// When it was asked last.
    heard: Option<Duration>,
    /// Whether a correction may be left of which nobody knows.
    unknown: bool,
}

impl Blind {
    pub(super) fn new(control: Option<ControlTimeOut>) -> Self {
        Self {
            control,
            acts: None,
            heard: None,
            unknown: false,
        }
    }

    pub(super) fn hear(&mut self, now: Duration, known: &mut Known) {
        self.heard = Some(now);
        if let Some([acts, at_zero]) = self.acts
            && now >= acts
        {
            // Nothing was written for so long that the control goes to zero, or is there.
            let was_zero = known
                .confirmed
                .is_some_and(|confirmed| confirmed.values == PerChannel::ZERO);
            self.unknown = now < at_zero && !was_zero;
            known.changed = !self.unknown && !was_zero;
            known.confirmed = (!self.unknown).then_some(Confirmed {
                values: PerChannel::ZERO,
                at: now,
            });
        }
        // Nothing was ever written, or restored: it counts as zero.
        if !self.unknown {
            known.confirmed.get_or_insert(Confirmed {
                values: PerChannel::ZERO,
                at: now,
            });
        }
        if let Some(confirmed) = &mut known.confirmed {
            // Nothing but this gateway moves it, so it does not grow old.
            confirmed.at = now;
        }
        known.writable = known.confirmed.is_some();
        known.until = self.acts.map(|[acts, _]| acts).filter(|acts| now < *acts);
        known.reasons = Reasons::NO_BARRIER
            | Reasons::CANNOT_SEE_OTHERS
            | Reasons::LEFT_UNKNOWN.when(self.unknown);
    }

    pub(super) fn sent(&mut self, now: Duration, values: &PerChannel<f64>, known: &mut Known) {
        // The control may have had it since the cycle began, or only now.
        self.wait([self.heard.unwrap_or(now), now], Duration::ZERO);
        known.confirmed = Some(Confirmed {
            values: *values,
            at: now,
        });
    }

    /// Something was written `age` before, at some time between these.
    fn wait(&mut self, [earliest, latest]: [Duration; 2], age: Duration) {
        self.acts = self.control.map(|control| {
            let to_zero = control.after + control.to_zero;
            [
                earliest + control.after.saturating_sub(age),
                latest + to_zero.saturating_sub(age),
            ]
        });
    }

    /// The output of the last run: it holds while the control cannot have acted by itself, is zero once it must have, and
    /// is unknown between.
    pub(super) fn restore(
        &mut self,
        now: Duration,
        values: &PerChannel<f64>,
        age: Duration,
        limits: &Limits,
        known: &mut Known,
    ) {
        let is_finite = (0..limits.count).all(|i| values[i].is_finite());
        let is_zero = (0..limits.count).all(|i| values[i].abs() <= 0.5 * limits.axes[i].resolution);
        let found = match self.control {
            _ if !is_finite => None,
            _ if is_zero => Some(PerChannel::ZERO),
            None => Some(*values),
            Some(control) if age < control.after => Some(*values),
            Some(control) if age > control.after + control.to_zero => Some(PerChannel::ZERO),
            Some(_) => None,
        };
        self.unknown = found.is_none();
        self.wait([now; 2], age);
        known.confirmed = found.map(|values| Confirmed { values, at: now });
    }

    /// Nothing is left of what another path has written, nor of what this one wrote before it.
    pub(super) fn take_over(&mut self, now: Duration, known: &mut Known) {
        (self.unknown, self.acts) = (false, None);
        known.confirmed = Some(Confirmed {
            values: PerChannel::ZERO,
            at: now,
        });
    }

    pub(super) fn acknowledge(&mut self, now: Duration, known: &mut Known) {
        // A control that is on its way to zero is known again once it must be there.
        if self.unknown && self.acts.is_none() {
            self.unknown = false;
            known.confirmed = Some(Confirmed {
                values: PerChannel::ZERO,
                at: now,
            });
        }
    }

    pub(super) fn zero_by_itself(&self, limits: &Limits) -> Option<Duration> {
        // A cycle more, since the last write may have been on its way.
        self.control
            .map(|control| control.after + control.to_zero + limits.period)
    }
}
