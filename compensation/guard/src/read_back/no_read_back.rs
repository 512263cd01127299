//! A control whose correction cannot be read back, such as one behind digital lines. If the device reports the levels of its outputs, the
//! correction on them counts as applied, like one that is read back; otherwise every write without an error does.

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use super::{
    echo::Echo,
    known::{Confirmed, Known, Landed, Told, are_equal},
};
use crate::{Limits, Reasons};

/// Behaviour of a control without read-back when writes stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ControlTimeOut {
    /// Time without a write after which it starts to go to zero.
    pub after: Duration,
    /// Time from its largest correction to zero.
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
    /// From when on the control may act on its own, and from when on it is at zero, without another write.
    acts: Option<[Duration; 2]>,
    /// When it was last read.
    heard: Option<Duration>,
    /// Whether an unknown correction may remain.
    unknown: bool,
    /// The device's reports of its outputs.
    echo: Echo,
    /// Whether it ever reported them, and whether it did in this cycle.
    tells: bool,
    sees: bool,
    /// Something was written.
    has_written: bool,
    /// The operator has acknowledged before anything was written.
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

    /// Whether the device ever reported its outputs.
    pub(super) fn tells(&self) -> bool {
        self.tells
    }

    /// Whether the outputs show the written correction.
    pub(super) fn sees(&self) -> bool {
        self.sees
    }

    /// Lowest and highest value of each axis that may be applied, if the outputs are reported.
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
            // The control is going to zero for lack of writes, or is there: earlier words, which may still be on its lines, no longer count.
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
        // If a control goes to zero on its own, the levels of its lines are meaningful only while it is written.
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
            // A reading that confirms a value also shows what has arrived.
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

    /// Without output levels the last write counts, since only this gateway writes the lines. A device that reported levels before may have lost
    /// them: they are known again only after another accepted write.
    fn hear_nothing(&mut self, now: Duration, known: &mut Known) {
        // If nothing was ever written or restored, it counts as zero.
        if !self.unknown {
            known.confirmed.get_or_insert(Confirmed {
                values: PerChannel::ZERO,
                at: now,
            });
        }
        if let Some(confirmed) = known.confirmed.as_mut().filter(|_| !self.tells) {
            // Only this gateway changes it, so it does not expire.
            confirmed.at = now;
        }
        known.writable = known.confirmed.is_some() && !self.unknown;
    }

    /// Records a write; `ok`: the device accepted it.
    pub(super) fn sent(
        &mut self,
        now: Duration,
        values: &PerChannel<f64>,
        ok: bool,
        known: &mut Known,
    ) {
        self.echo.sent(now, values);
        if !ok {
            // If a device stops reporting its outputs and a write fails, their levels are unknown.
            self.unknown |= self.tells && !self.sees;
            return;
        }
        self.has_written = true;
        // The control may have received it at the begin of the cycle, or only now.
        self.wait([self.heard.unwrap_or(now), now], Duration::ZERO);
        if self.sees {
            return;
        }
        known.confirmed = Some(Confirmed {
            values: *values,
            at: now,
        });
    }

    /// Starts the control's timeout from a write `age` ago, made between these times.
    fn wait(&mut self, [earliest, latest]: [Duration; 2], age: Duration) {
        self.acts = self.control.map(|control| {
            let to_zero = control.all();
            [
                earliest.saturating_add(control.after.saturating_sub(age)),
                latest.saturating_add(to_zero.saturating_sub(age)),
            ]
        });
    }

    /// Restores the output of the last run: it is applied while the control cannot have acted on its own, is zero once it must have, and is unknown
    /// in between.
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

    /// Nothing remains of the correction of another path. This path's own earlier one remains, unless the control has dropped it, too (`let_go`),
    /// as its barrier does, or has acted on its own by the time since the last write.
    pub(super) fn take_over(&mut self, now: Duration, let_go: bool, known: &mut Known) {
        if self.tells {
            // The outputs keep their levels: they are read before the first write.
            self.acts = None;
            self.echo.take_over(now, known);
        } else if let_go {
            self.acts = None;
            self.is_zero(now, known);
        } else if self.control.is_none() && !self.has_written {
            // The stored correction may have been written by another path in the previous run.
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
        // A control on its way to zero is known again once it must be there.
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
        // One more cycle, since the last write may have been in transit.
        self.control
            .map(|control| control.all().saturating_add(limits.period))
    }
}
