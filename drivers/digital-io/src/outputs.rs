//! The outputs that carry the correction: the next levels to write, and the correction that the control has received.

use std::time::Instant;

use volcomp_port::{DigitalIo, Fault};
use volcomp_vocabulary::PerChannel;

use crate::{axis::DigitalAxis, wiring::Wiring};

/// Progress of a correction over lines with a latch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Latching {
    /// The latch is unchanged since the last correction was received.
    Taken,
    /// These levels were written. The latch is toggled when they are confirmed.
    Settling(u64),
    /// The latch was toggled with these levels unchanged.
    Turned(u64),
}

/// The outputs of a controller on lines.
pub(crate) struct Outputs {
    latching: Latching,
    /// The last written level of the latch, as a bit.
    latch: u64,
    taken: PerChannel<Option<f64>>,
    /// The correction received for the only axis, if the device reports its output levels.
    carried: Option<PerChannel<f64>>,
}

impl Outputs {
    pub(crate) fn new() -> Self {
        Self {
            latching: Latching::Taken,
            latch: 0,
            taken: PerChannel::from_fn(|_| None),
            carried: None,
        }
    }

    /// The corrections that the lines carried with the last confirmed write, by axis; `None` for an axis that was not written yet.
    pub(crate) fn taken(&self) -> &PerChannel<Option<f64>> {
        &self.taken
    }

    /// The correction on the lines now, also before the first write, if the device reports its output levels. If several axes share the lines, it
    /// is that of one of them only.
    pub(crate) fn carried(&self) -> Option<PerChannel<f64>> {
        self.carried
    }

    /// Writes a word for an axis. With a latch, a correction takes two writes: the word, then, when it is confirmed, the latch alone.
    ///
    /// # Errors
    /// See [`DigitalIo::write`]. The sequence does not advance then. Nothing is written while the levels of unused outputs are unknown, unless the
    /// device cannot report them.
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
        let (levels, next) = self.next(wiring, wiring.levels(word, axis), confirmed);
        io.write(levels, deadline)?;
        (self.latching, self.latch) = (next, levels & wiring.latch_bit());
        Ok(())
    }

    /// The levels to write next, and the state after that. Unused lines keep the levels that they were found with.
    fn next(&self, wiring: &Wiring, word: u64, confirmed: Option<u64>) -> (u64, Latching) {
        let bit = wiring.latch_bit();
        let others = confirmed.unwrap_or(0) & !wiring.used_outputs();
        if bit == 0 {
            return (word | others, Latching::Taken);
        }
        let turned = match (self.latching, confirmed) {
            (Latching::Settling(levels), Some(found)) if found == levels => Some(levels ^ bit),
            // It is unknown whether the latch has toggled, so nothing else may change with it.
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

    /// Processes the levels confirmed since. `wrote`: whether a write was made.
    pub(crate) fn note(
        &mut self,
        io: &impl DigitalIo,
        wiring: &Wiring,
        axes: &[DigitalAxis],
        wrote: bool,
    ) {
        let Some(levels) = io.confirmed() else {
            self.carried = None;
            return;
        };
        let waits = match self.latching {
            Latching::Taken => false,
            Latching::Settling(_) => true,
            Latching::Turned(turned) => turned != levels,
        };
        let (word, axis) = wiring.control_inputs(levels);
        let index = usize::try_from(axis).unwrap_or(usize::MAX);
        let correction = axes
            .get(index)
            .and_then(|axis| axis.correction.decode(word));
        let Some(correction) = correction.filter(|_| !waits) else {
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
}
