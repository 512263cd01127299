//! Outputs with the correction: the levels to write next, and the correction that the control has received.

use std::time::Instant;

use volcomp_port::{DigitalIo, Fault};
use volcomp_vocabulary::PerChannel;

use crate::{axis::DigitalAxis, wiring::Wiring};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Latching {
    /// The control has received the last correction, and the latch has not changed since.
    Taken,
    /// These levels were written; the latch is toggled once they are confirmed.
    Settling(u64),
    /// The latch was toggled; the other lines keep these levels.
    Turned(u64),
}

pub(crate) struct Outputs {
    latching: Latching,
    /// Last written level of the latch, at its bit.
    latch: u64,
    taken: PerChannel<Option<f64>>,
    /// Correction on the lines of the only axis, if the device reports its output levels.
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

    /// Corrections on the lines at the last confirmed write, by axis, mm or rad; `None` for an axis not written yet.
    pub(crate) fn taken(&self) -> &PerChannel<Option<f64>> {
        &self.taken
    }

    /// Correction on the lines now, also before the first write; `None` if the device does not report its output levels, or if there are several
    /// axes.
    pub(crate) fn carried(&self) -> Option<PerChannel<f64>> {
        self.carried
    }

    /// Writes the word of an axis. With a latch, a correction takes two writes: the word, then, once that is confirmed, the latch alone. Errors: see
    /// [`DigitalIo::write`]; the sequence does not advance then. While the levels of unused outputs are unknown nothing is written, unless the device
    /// cannot report them.
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

    /// Levels to write next, and the state after that write. Unused lines keep the levels that the device has confirmed.
    fn next(&self, wiring: &Wiring, word: u64, confirmed: Option<u64>) -> (u64, Latching) {
        let bit = wiring.latch_bit();
        let others = confirmed.unwrap_or(0) & !wiring.used_outputs();
        if bit == 0 {
            return (word | others, Latching::Taken);
        }
        let turned = match (self.latching, confirmed) {
            (Latching::Settling(levels), Some(found)) if found == levels => Some(levels ^ bit),
            // Whether the latch has toggled is unknown, so no other line may change with it.
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

    /// Updates the state from the levels that the device has confirmed. `wrote`: whether anything was written since the start.
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
        let correction = axes.get(index).and_then(|axis| axis.correction.decode(word));
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
