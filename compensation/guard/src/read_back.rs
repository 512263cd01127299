//! Knowledge of the correction that a control applies.
//!
//! No value from a wire counts before it is confirmed, and no sent correction counts as applied before it is seen. The method depends on the
//! control: a [`barrier`](crate::barrier), words that can be read back, or neither.

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

/// The read-back of one path. State: what was sent, what was received, and the conclusions.
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
    /// For a control with a barrier.
    #[must_use]
    pub fn barrier(link: BarrierLink) -> Self {
        Self::of(Kind::Barrier(link), Scheme::Barrier)
    }

    /// For a control without a barrier whose correction can be read back. During `watch` before the first write nothing but this gateway may move
    /// the correction; this reveals another gateway, or a control that is still ramping to zero.
    #[must_use]
    pub fn plain(watch: Duration) -> Self {
        Self::of(Kind::Echo(Echo::new(watch)), Scheme::Plain)
    }

    /// For a control whose correction cannot be read back. `control` is the time without a write after which it goes to zero on its own; `None`: it
    /// keeps its correction.
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

    /// The knowledge after the last call.
    #[must_use]
    pub fn known(&self) -> &Known {
        &self.known
    }

    /// Processes the control's report in this cycle. `taken` is when it was valid: anything older than `hold` is ignored, however often a device
    /// repeats it.
    pub fn hear(&mut self, now: Duration, taken: Duration, told: &Told<'_>, limits: &Limits) {
        // No reading is from the future, whatever a device reports.
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
        // Lines that never reported their outputs count as answering.
        let answered = !is_told || *told != Told::Nothing;
        self.landing.hear(now, answered, landed, limits);
        self.update_known();
    }

    /// Whether the applied correction is reported, so that sent corrections can be seen to arrive.
    fn is_seen(&self) -> bool {
        match &self.kind {
            Kind::Barrier(_) | Kind::Echo(_) => true,
            Kind::NoReadBack(lines) => lines.sees(),
        }
    }

    /// Updates the conclusions for the guard.
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

    /// Reports that another gateway was detected on this path.
    pub fn see_other(&mut self, now: Duration) {
        if let Kind::Echo(echo) = &mut self.kind {
            echo.see_other(now);
        }
    }

    /// Encodes the frame that requests a correction (mm, rad), for a control with a barrier, and returns its number of words; `None` if nothing may
    /// be sent now. Send it at once.
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

    /// Records a sent correction (mm, rad). `ok`: without an error. A failed one may still have arrived, except on lines, where a failed write has
    /// no effect.
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

    /// Restores the output of the last run, written `age` ago, for controls without read-back.
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

    /// Makes this path the active one in place of another. Without read-back here, the correction from the other path must be gone: this path takes
    /// over only after that. Its own earlier correction remains, unless the control has dropped everything (`let_go`), because the other path led
    /// to its barrier. With a read-back but no barrier, earlier readings may be older than the last write of the other path.
    pub fn take_over(&mut self, now: Duration, let_go: bool) {
        match &mut self.kind {
            Kind::NoReadBack(lines) => lines.take_over(now, let_go, &mut self.known),
            Kind::Echo(echo) => echo.take_over(now, &mut self.known),
            Kind::Barrier(_) => return,
        }
        self.landing = Landing::default();
        self.update_known();
    }

    /// The operator has made sure that a control without read-back applies no correction.
    pub fn acknowledge(&mut self, now: Duration) {
        if let Kind::NoReadBack(lines) = &mut self.kind {
            lines.acknowledge(now, &mut self.known);
        }
        self.update_known();
    }

    /// Time after the last write until the control is at zero on its own, from any correction; `None`: it never goes there on its own, or that is
    /// unknown.
    #[must_use]
    pub fn zero_by_itself(&self, limits: &Limits) -> Option<Duration> {
        match &self.kind {
            Kind::Barrier(link) => link.zero_by_itself(limits),
            Kind::NoReadBack(lines) => lines.zero_by_itself(limits),
            Kind::Echo(_) => None,
        }
    }
}
