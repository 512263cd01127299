//! What is known of the correction that a control applies.
//!
//! Nothing that comes over a wire is true until it has been confirmed, and nothing that was sent has landed until it has
//! been seen. How a value is confirmed depends on what the control has: a [`barrier`](crate::barrier), words that can be
//! read back, or neither.

mod barrier;
mod echo;
mod known;
mod no_read_back;

use core::time::Duration;

use volcomp_vocabulary::PerChannel;

use crate::{Limits, barrier::FRAME_WORDS};

pub use barrier::{BarrierLink, BarrierMisfit, RATE_OVER_SLEW, barrier_misfits, scans_fit};
pub(crate) use known::are_equal;
pub use known::{Confirmed, Known, Scheme, Told};
pub use no_read_back::ControlTimeOut;

use echo::Echo;
use known::{Landed, Landing};
use no_read_back::NoReadBack;

/// The read-back of one path. State: what was sent, what was received, what follows from both.
#[derive(Clone, Debug)]
pub struct ReadBack {
    kind: Kind,
    known: Known,
    landing: Landing,
}

#[derive(Clone, Debug)]
enum Kind {
    Barrier(BarrierLink),
    Echo(Echo),
    NoReadBack(NoReadBack),
}

impl ReadBack {
    /// A control with a barrier.
    #[must_use]
    pub fn barrier(link: BarrierLink) -> Self {
        Self::of(Kind::Barrier(link), Scheme::Barrier)
    }

    /// A control without a barrier whose correction can be read back. For `watch` nothing but this gateway may have moved
    /// anything before the first write: another gateway, or a control that is still on its way to zero, would show.
    #[must_use]
    pub fn plain(watch: Duration) -> Self {
        Self::of(Kind::Echo(Echo::new(watch)), Scheme::Plain)
    }

    /// A control whose correction cannot be read back. `control` says after what time without a write it goes to zero
    /// on its own; `None`: it keeps what it has.
    #[must_use]
    pub fn no_read_back(control: Option<ControlTimeOut>) -> Self {
        Self::of(
            Kind::NoReadBack(NoReadBack::new(control)),
            Scheme::NoReadBack,
        )
    }

    fn of(kind: Kind, scheme: Scheme) -> Self {
        Self {
            kind,
            known: Known {
                scheme,
                ..Known::default()
            },
            landing: Landing::default(),
        }
    }

    /// What is known after the last call.
    #[must_use]
    pub fn known(&self) -> &Known {
        &self.known
    }

    /// Takes what the control reported in this cycle. `taken` is when that held: what held longer ago than `hold` counts no
    /// more, however often a device repeats it.
    pub fn hear(&mut self, now: Duration, taken: Duration, told: &Told<'_>, limits: &Limits) {
        // No reading is from the future, whatever a device says.
        let taken = taken.min(now);
        let is_old = now.saturating_sub(taken) > limits.hold;
        let told = if is_old { &Told::Nothing } else { told };
        self.known.changed = false;
        let landed = match (&mut self.kind, told) {
            (Kind::Barrier(link), Told::Report(words)) => {
                link.hear(taken, words, limits, &mut self.known)
            }
            (Kind::Barrier(_), _) => Landed::Unknown,
            (Kind::Echo(echo), Told::Values(values)) => {
                echo.hear(now, taken, values, limits, &mut self.known)
            }
            (Kind::Echo(_), _) => {
                self.known.writable = false;
                Landed::Unknown
            }
            (Kind::NoReadBack(lines), told) => {
                lines.hear(now, taken, told, limits, &mut self.known)
            }
        };
        match &self.kind {
            Kind::Barrier(link) => link.judge(now, limits, &mut self.known),
            Kind::Echo(echo) => echo.judge(now, limits, &mut self.known),
            Kind::NoReadBack(_) => {}
        }
        let is_told = match &self.kind {
            Kind::Barrier(_) | Kind::Echo(_) => true,
            Kind::NoReadBack(lines) => lines.tells(),
        };
        // Lines that report nothing are not waited for.
        let answered = !is_told || *told != Told::Nothing;
        self.landing.hear(now, answered, landed, limits);
        self.update_known();
    }

    /// Whether it is reported what is applied, so that what was sent is seen to land.
    fn is_seen(&self) -> bool {
        match &self.kind {
            Kind::Barrier(_) | Kind::Echo(_) => true,
            Kind::NoReadBack(lines) => lines.sees(),
        }
    }

    /// What follows for the guard.
    fn update_known(&mut self) {
        self.known.unlanded_since = self.landing.unlanded_since();
        let candidates = match &self.kind {
            Kind::Echo(echo) => echo.between(),
            Kind::NoReadBack(lines) => lines.between(),
            Kind::Barrier(_) => None,
        };
        let confirmed = self.known.confirmed.map_or(PerChannel::ZERO, |c| c.values);
        self.known.between = candidates.unwrap_or([confirmed; 2]);
    }

    /// Another gateway was seen on this path.
    pub fn see_other(&mut self, now: Duration) {
        if let Kind::Echo(echo) = &mut self.kind {
            echo.see_other(now);
        }
    }

    /// The frame that asks for a correction (mm, rad), for a control with a barrier: writes its words and gives their
    /// number. `None` where nothing may be sent now. To be sent at once.
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

    /// A frame with this epoch and sequence went to the barrier by another path of this gateway.
    pub fn also_sent(&mut self, frame: (u16, u16)) {
        if let Kind::Barrier(link) = &mut self.kind {
            link.also_sent(frame);
        }
    }

    /// A correction (mm, rad) was sent; `ok`: without a failure. One that failed may still have landed, except on
    /// lines, where a write that failed does not count.
    pub fn sent(&mut self, now: Duration, values: &PerChannel<f64>, ok: bool) {
        match &mut self.kind {
            Kind::Echo(echo) => echo.sent(now, values),
            Kind::NoReadBack(lines) => lines.sent(now, values, ok, &mut self.known),
            Kind::Barrier(_) => {}
        }
        let is_unseen = !self.is_seen();
        self.landing.sent(now, ok, is_unseen);
        self.update_known();
    }

    /// The output of the last run, for controls without read-back: it was written `age` ago.
    pub fn restore(
        &mut self,
        now: Duration,
        values: &PerChannel<f64>,
        age: Duration,
        limits: &Limits,
    ) {
        if let Kind::NoReadBack(lines) = &mut self.kind {
            lines.restore(now, values, age, limits, &mut self.known);
        }
        self.update_known();
    }

    /// This path writes from now on in place of another one. What the control applied by way of the other one is gone
    /// where this one has no read-back: it takes over only once nothing of it is left. What this one wrote before remains,
    /// unless the control has `let_go` of everything: the other one led to its barrier. Where it has a read-back without a
    /// barrier, what it read before may be older than what the other one sent last.
    pub fn take_over(&mut self, now: Duration, let_go: bool) {
        match &mut self.kind {
            Kind::NoReadBack(lines) => lines.take_over(now, let_go, &mut self.known),
            Kind::Echo(echo) => echo.take_over(now, &mut self.known),
            Kind::Barrier(_) => return,
        }
        self.landing = Landing::default();
        self.update_known();
    }

    /// The operator has made sure that a control without read-back applies nothing.
    pub fn acknowledge(&mut self, now: Duration) {
        if let Kind::NoReadBack(lines) = &mut self.kind {
            lines.acknowledge(now, &mut self.known);
        }
        self.update_known();
    }

    /// How long after the last write the control is at zero on its own, whatever it applied; `None`: it never goes there
    /// on its own, or that is not known.
    #[must_use]
    pub fn zero_by_itself(&self, limits: &Limits) -> Option<Duration> {
        match &self.kind {
            Kind::Barrier(link) => link.zero_by_itself(limits),
            Kind::NoReadBack(lines) => lines.zero_by_itself(limits),
            Kind::Echo(_) => None,
        }
    }
}
