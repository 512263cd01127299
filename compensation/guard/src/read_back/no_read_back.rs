//! A control whose correction cannot be read back, such as one behind lines. Where the device reports which levels its
//! outputs carry, what they carry counts as applied, as a correction that is read back; where it does not, what was
//! written without a failure does.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use super::{
    echo::Echo,
    known::{Confirmed, Known, Landed, Told, are_equal},
};
use crate::{Limits, Reasons};

/// What a control without read-back does on its own when nothing is written any more.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlTimeOut {
    /// Time without a write after which it goes to zero.
    pub after: Duration,
    /// The time that it needs from its largest correction to zero.
    pub to_zero: Duration,
}

impl ControlTimeOut {
    /// Time without a write after which it is at zero.
    fn all(&self) -> Duration {
        self.after.saturating_add(self.to_zero)
    }
}

#[derive(Clone, Debug)]
#[expect(clippy::struct_excessive_bools, reason = "five facts, each of its own")]
pub(super) struct NoReadBack {
    control: Option<ControlTimeOut>,
    /// From when on the control may act on its own, and from when on it is at zero, unless something is written before.
    acts: Option<[Duration; 2]>,
    /// When it was read last.
    heard: Option<Duration>,
    /// Whether an unknown correction may be left.
    unknown: bool,
    /// What the device reports of its outputs.
    echo: Echo,
    /// Whether it ever reported that, and whether it did in this cycle so that it counts.
    tells: bool,
    sees: bool,
    /// Something was written.
    has_written: bool,
    /// A person has looked before anything was written.
    was_looked_at: bool,
}

impl NoReadBack {
    pub(super) fn new(control: Option<ControlTimeOut>) -> Self {
        Self {
            control,
            acts: None,
            heard: None,
            unknown: false,
            echo: Echo::new(Duration::ZERO),
            tells: false,
            sees: false,
            has_written: false,
            was_looked_at: false,
        }
    }

    /// Whether the device ever reported what its outputs carry.
    pub(super) fn tells(&self) -> bool {
        self.tells
    }

    /// Whether what was written is seen on the outputs.
    pub(super) fn sees(&self) -> bool {
        self.sees
    }

    /// The lowest and the highest value of each axis that may be applied, where the outputs are seen.
    pub(super) fn between(&self) -> Option<[PerChannel<f64>; 2]> {
        self.echo.between().filter(|_| self.sees)
    }

    pub(super) fn hear(
        &mut self,
        now: Duration,
        taken: Duration,
        told: &Told<'_>,
        limits: &Limits,
        known: &mut Known,
    ) -> Landed {
        self.heard = Some(now);
        if let Some([acts, at_zero]) = self.acts
            && now >= acts
        {
            // The control goes to zero since nothing was written, or is there: what was sent before, and may
            // still stand on its lines, counts no more.
            self.echo = Echo::new(Duration::ZERO);
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
        // The levels of lines say something about a control that goes to zero on its own only while it is written.
        let is_on = self.control.is_none()
            || self.has_written && self.acts.is_some_and(|[acts, _]| now < acts);
        let told = match told {
            Told::Values(values) if is_on => Some(values),
            _ => None,
        };
        self.tells |= told.is_some();
        self.sees = told.is_some();
        let landed = told.map_or(Landed::Unknown, |values| {
            let landed = self.echo.hear(now, taken, values, limits, known);
            self.echo.judge(now, limits, known);
            // A reading that confirms also shows what has landed.
            self.unknown &= landed == Landed::Unknown;
            landed
        });
        if !self.sees {
            self.hear_nothing(now, known);
        }
        known.until = self.acts.map(|[acts, _]| acts).filter(|acts| now < *acts);
        known.reasons = Reasons::NO_BARRIER
            | Reasons::CANNOT_SEE_OTHERS
            | Reasons::LEFT_UNKNOWN.when(self.unknown);
        landed
    }

    /// Without the levels of the outputs what was written counts, since nothing but this gateway writes them. A device that
    /// reported them before may have lost them meanwhile: only another write that it takes keeps them known.
    fn hear_nothing(&mut self, now: Duration, known: &mut Known) {
        // Nothing was ever written, or restored: it counts as zero.
        if !self.unknown {
            known.confirmed.get_or_insert(Confirmed {
                values: PerChannel::ZERO,
                at: now,
            });
        }
        if let Some(confirmed) = known.confirmed.as_mut().filter(|_| !self.tells) {
            // Nothing but this gateway moves it, so it does not grow old.
            confirmed.at = now;
        }
        known.writable = known.confirmed.is_some() && !self.unknown;
    }

    /// Something was written: `ok` where the device took it.
    pub(super) fn sent(
        &mut self,
        now: Duration,
        values: &PerChannel<f64>,
        ok: bool,
        known: &mut Known,
    ) {
        self.echo.sent(now, values);
        if !ok {
            // What a device that reported its outputs does unseen is unknown.
            self.unknown |= self.tells && !self.sees;
            return;
        }
        self.has_written = true;
        // The control may have had it since the cycle began, or only now.
        self.wait([self.heard.unwrap_or(now), now], Duration::ZERO);
        if self.sees {
            return;
        }
        known.confirmed = Some(Confirmed {
            values: *values,
            at: now,
        });
    }

    /// Something was written `age` before, at some time between these.
    fn wait(&mut self, [earliest, latest]: [Duration; 2], age: Duration) {
        self.acts = self.control.map(|control| {
            let to_zero = control.all();
            [
                earliest.saturating_add(control.after.saturating_sub(age)),
                latest.saturating_add(to_zero.saturating_sub(age)),
            ]
        });
    }

    /// The output of the last run: it holds while the control cannot have acted on its own, is zero once it must have, and
    /// is unknown between.
    pub(super) fn restore(
        &mut self,
        now: Duration,
        values: &PerChannel<f64>,
        age: Duration,
        limits: &Limits,
        known: &mut Known,
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
        known.confirmed = found.map(|values| Confirmed { values, at: now });
    }

    /// Nothing is left of what another path has written. What this one wrote before it stands, unless the control has let
    /// go of that, too, as its barrier does, or acts on its own: that goes by the time since the last write.
    pub(super) fn take_over(&mut self, now: Duration, let_go: bool, known: &mut Known) {
        if self.tells {
            // The outputs stay as they are: they are read before the first write.
            self.acts = None;
            self.echo.take_over(now, known);
        } else if let_go {
            self.acts = None;
            self.is_zero(now, known);
        } else if self.control.is_none() && !self.has_written {
            // What was remembered may be what another path wrote in the run before.
            let zero = |confirmed: Confirmed| confirmed.values == PerChannel::ZERO;
            if self.was_looked_at || known.confirmed.is_none_or(zero) && !self.unknown {
                self.is_zero(now, known);
            } else {
                (self.unknown, known.confirmed) = (true, None);
            }
        }
    }

    pub(super) fn acknowledge(&mut self, now: Duration, known: &mut Known) {
        self.was_looked_at |= !self.has_written;
        // A control that is on its way to zero is known again once it must be there.
        if self.unknown && self.acts.is_none() {
            self.is_zero(now, known);
        }
    }

    /// Nothing is applied.
    fn is_zero(&mut self, now: Duration, known: &mut Known) {
        self.unknown = false;
        known.confirmed = Some(Confirmed {
            values: PerChannel::ZERO,
            at: now,
        });
    }

    pub(super) fn zero_by_itself(&self, limits: &Limits) -> Option<Duration> {
        // A cycle more, since the last write may have been on its way.
        self.control
            .map(|control| control.all().saturating_add(limits.period))
    }
}
