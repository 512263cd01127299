//! Outputs with the correction: computes the levels to write next, and tracks the correction that the control has
//! received.

use std::time::Instant;

use volcomp_port::{DigitalIo, Fault};
use volcomp_vocabulary::PerChannel;

use crate::{axis::DigitalAxis, wiring::Wiring};

/// Time limit for toggling the latch, as a multiple of the time limit of one write: one limit until a write has failed,
/// and two limits for one cycle, which is shorter.
const LATCHED_WITHIN: u32 = 3;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Latching {
    /// The control has received the last correction, and the latch has not changed since then.
    Taken,
    /// The word was written with these levels. The latch toggles once the device has confirmed them.
    Settling(u64),
    /// The latch was toggled, giving these levels. No other line changes until the device has confirmed them.
    Turned(u64),
}

pub(crate) struct Outputs {
    latching: Latching,
    /// Time until which the latch may be toggled for the last written word.
    latched_by: Instant,
    /// Last confirmed level of the latch, as a bit at the position of its line.
    seen_latch: Option<u64>,
    /// Whether the device currently reports its output levels.
    is_reported: bool,
    taken: PerChannel<Option<f64>>,
    /// Correction that the control last received, if there is only one axis.
    carried: Option<PerChannel<f64>>,
}

impl Outputs {
    pub(crate) fn new() -> Self {
        Self {
            latching: Latching::Taken,
            latched_by: Instant::now(),
            seen_latch: None,
            is_reported: false,
            taken: PerChannel::from_fn(|_| None),
            carried: None,
        }
    }

    /// Corrections on the lines at the last confirmed write, by axis, mm or rad; `None` for an axis that was not
    /// written yet.
    pub(crate) fn taken(&self) -> &PerChannel<Option<f64>> {
        &self.taken
    }

    /// Correction on the lines now; it is known before the first write, too. NaN for a word that encodes none, so that the
    /// guard writes nothing over it. `None` if the device does not report its output levels, or if there are several axes.
    pub(crate) fn carried(&self) -> Option<PerChannel<f64>> {
        self.carried.filter(|_| self.is_reported)
    }

    /// Writes the word of an axis. With a latch, a correction takes two writes: the word, then, once that is confirmed, the
    /// latch alone. While the level of the latch is unknown nothing is written, because the latch could toggle together
    /// with the word. While the levels of unused outputs are unknown nothing is written, unless the device cannot report
    /// them. Errors: see [`DigitalIo::write`].
    pub(crate) fn write(
        &mut self,
        io: &mut impl DigitalIo,
        wiring: &Wiring,
        (word, axis): (u32, u32),
        deadline: Instant,
    ) -> Result<(), Fault> {
        let confirmed = io.confirmed();
        let has_others = wiring.leaves_outputs(io.outputs());
        let now = Instant::now();
        let word = wiring.levels(word, axis);
        let (levels, next) = match confirmed {
            Some(confirmed) => self.next(wiring, word, confirmed, now),
            None if wiring.latch.is_some() => {
                return Err(Fault::Unsupported(
                    "a latch while the module does not report its level",
                ));
            }
            None if has_others && io.reports_outputs() => {
                return Err(Fault::Unsupported(
                    "writing while the levels of other outputs are unknown",
                ));
            }
            None => (word, Latching::Taken),
        };
        // A word that is sent again keeps its time limit.
        let is_resent = now <= self.latched_by
            && matches!(
                (self.latching, next),
                (Latching::Settling(a), Latching::Settling(b)) if (a ^ b) & wiring.used_outputs() == 0
            );
        if !is_resent && matches!(next, Latching::Settling(_)) {
            let within = deadline.saturating_duration_since(now).saturating_mul(LATCHED_WITHIN);
            self.latched_by = now.checked_add(within).unwrap_or(deadline);
        }
        // A write that fails may have been sent nevertheless.
        self.latching = next;
        io.write(levels, deadline)
    }

    /// The levels to write next, and the state after that write. Unused lines keep the levels that the device has
    /// confirmed. After the time limit the requested word replaces the unconfirmed one: the control may be at zero by
    /// then, and the earlier word would be a step.
    fn next(&self, wiring: &Wiring, word: u64, confirmed: u64, now: Instant) -> (u64, Latching) {
        let bit = wiring.latch_bit();
        let others = confirmed & !wiring.used_outputs();
        if bit == 0 {
            return (word | others, Latching::Taken);
        }
        // Until a word is confirmed no other one is sent: an earlier equal word would confirm it, while the other one is
        // still on its way.
        if let Latching::Settling(levels) = self.latching
            && now <= self.latched_by
            && confirmed != levels
            && (confirmed ^ levels) & bit == 0
        {
            let levels = levels & wiring.used_outputs() | others;
            return (levels, Latching::Settling(levels));
        }
        let turned = match self.latching {
            _ if now > self.latched_by => None,
            Latching::Settling(levels) if confirmed == levels => Some(levels ^ bit),
            Latching::Turned(levels) if confirmed ^ levels == bit => Some(levels),
            _ => None,
        };
        if let Some(levels) = turned {
            return (levels, Latching::Turned(levels));
        }
        let levels = word | others | confirmed & bit;
        (levels, Latching::Settling(levels))
    }

    /// Updates the state from the levels that the device has confirmed. `wrote` is true if anything was written since
    /// the start.
    pub(crate) fn note(
        &mut self,
        io: &impl DigitalIo,
        wiring: &Wiring,
        axes: &[DigitalAxis],
        wrote: bool,
    ) {
        let confirmed = io.confirmed();
        self.is_reported = confirmed.is_some();
        let Some(levels) = confirmed else {
            return;
        };
        if !self.is_received(wiring, levels) {
            return;
        }
        let (word, axis) = wiring.control_inputs(levels);
        let index = usize::try_from(axis).unwrap_or(usize::MAX);
        let Some(axis) = axes.get(index) else {
            return;
        };
        let correction = axis.correction.decode(word);
        if axes.len() == 1 {
            let mut carried = PerChannel::ZERO;
            carried[index] = correction.unwrap_or(f64::NAN);
            self.carried = Some(carried);
        }
        if wrote {
            self.taken[index] = correction;
        }
    }

    /// Whether the control has received the word in these confirmed levels. With a latch the control receives a word at
    /// each edge, also at an edge that the device causes, for example by a loss of its supply. If outputs fall without
    /// an edge, the control receives nothing.
    fn is_received(&mut self, wiring: &Wiring, levels: u64) -> bool {
        let bit = wiring.latch_bit();
        if bit == 0 {
            return true;
        }
        let has_edge = match self.seen_latch.replace(levels & bit) {
            Some(before) => before != levels & bit,
            // The levels that are found at the start count as received.
            None => self.latching == Latching::Taken,
        };
        let Latching::Turned(turned) = self.latching else {
            return has_edge;
        };
        // The device lost its outputs while the latch was being toggled. The order of both is unknown, so the outputs
        // count as received.
        let is_lost = (turned ^ levels) & wiring.used_outputs() & !bit != 0;
        if is_lost || turned == levels {
            self.latching = Latching::Taken;
        }
        has_edge || is_lost
    }
}
