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
    /// Last written level of the latch, as a bit at the position of its line.
    latch: u64,
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
            latch: 0,
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

    /// Correction that the control last received, known even before the first write. `None` if the device does not
    /// report its output levels, or if there are several axes.
    pub(crate) fn carried(&self) -> Option<PerChannel<f64>> {
        self.carried.filter(|_| self.is_reported)
    }

    /// Writes the word of an axis. With a latch a correction takes two writes: the word and, once the word is
    /// confirmed, the latch alone. While the levels of unused outputs are unknown, nothing is written, unless the
    /// device cannot report levels.
    ///
    /// Errors: see [`DigitalIo::write`]. After an error the sequence does not advance.
    pub(crate) fn write(
        &mut self,
        io: &mut impl DigitalIo,
        wiring: &Wiring,
        (word, axis): (u32, u32),
        deadline: Instant,
    ) -> Result<(), Fault> {
        let confirmed = io.confirmed();
        let has_others = wiring.leaves_outputs(io.outputs());
        if confirmed.is_none() && has_others && io.reports_outputs() {
            return Err(Fault::Unsupported(
                "writing while the levels of other outputs are unknown",
            ));
        }
        let now = Instant::now();
        let (levels, next) = self.next(wiring, wiring.levels(word, axis), confirmed, now);
        io.write(levels, deadline)?;
        if matches!(next, Latching::Settling(_)) {
            let within = deadline.saturating_duration_since(now).saturating_mul(LATCHED_WITHIN);
            self.latched_by = now.checked_add(within).unwrap_or(deadline);
        }
        (self.latching, self.latch) = (next, levels & wiring.latch_bit());
        Ok(())
    }

    /// The levels to write next, and the state after that write. Unused lines keep the levels that the device has
    /// confirmed. After the time limit of the latch the word is written anew before the latch toggles, because the
    /// control may be at zero by then, and an edge for the earlier word would step the correction.
    fn next(
        &self,
        wiring: &Wiring,
        word: u64,
        confirmed: Option<u64>,
        now: Instant,
    ) -> (u64, Latching) {
        let bit = wiring.latch_bit();
        let others = confirmed.unwrap_or(0) & !wiring.used_outputs();
        if bit == 0 {
            return (word | others, Latching::Taken);
        }
        let turned = match (self.latching, confirmed) {
            _ if now > self.latched_by => None,
            (Latching::Settling(levels), Some(found)) if found == levels => Some(levels ^ bit),
            // It is unknown whether the latch has toggled, so no other line may change together with the latch.
            (Latching::Turned(levels), None) => Some(levels),
            (Latching::Turned(levels), Some(found)) if found ^ levels == bit => Some(levels),
            _ => None,
        };
        if let Some(levels) = turned {
            return (levels, Latching::Turned(levels));
        }
        let latch = confirmed.unwrap_or(self.latch) & bit;
        let levels = word | others | latch;
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
        let correction = axes.get(index).and_then(|axis| axis.correction.decode(word));
        let Some(correction) = correction else {
            return;
        };
        if axes.len() == 1 {
            let mut carried = PerChannel::ZERO;
            carried[index] = correction;
            self.carried = Some(carried);
        }
        if wrote {
            self.taken[index] = Some(correction);
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
