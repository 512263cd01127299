//! The outputs with the correction: which levels are written next, and which correction the control has taken.

use std::time::Instant;

use volcomp_port::{DigitalIo, Fault};
use volcomp_vocabulary::PerChannel;

use crate::{axis::DigitalAxis, wiring::Wiring};

/// How far a correction is on its way over lines with a latch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Latching {
    /// The latch stands where it was when the last correction was taken.
    Taken,
    /// These levels were written; the latch turns when they are confirmed.
    Settling(u64),
    /// The latch was turned with these levels, and nothing else.
    Turned(u64),
}

/// The outputs of a controller on lines.
pub(crate) struct Outputs {
    latching: Latching,
    /// The last level of the latch that was written, as a bit.
    latch: u64,
    taken: PerChannel<Option<f64>>,
    /// What the control has taken of the only axis, as far as the device tells the levels of its outputs.
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

    /// The corrections that the control's inputs carried last with a confirmed write, axis by axis; `None` for an axis
    /// that was not written yet.
    pub(crate) fn taken(&self) -> &PerChannel<Option<f64>> {
        &self.taken
    }

    /// The correction that the lines carry now, from before the first write on, as far as the device tells; where several
    /// axes share the lines, they carry one of them only.
    pub(crate) fn carried(&self) -> Option<PerChannel<f64>> {
        self.carried
    }

    /// Writes a word for an axis. With a latch two writes carry one correction: the word, and, when it is confirmed,
    /// the latch alone.
    ///
    /// # Errors
    /// See [`DigitalIo::write`]. What was sent does not advance then. Nothing is written while the levels of outputs that
    /// carry nothing are not known, unless the device cannot tell them.
    pub(crate) fn write(
        &mut self,
        io: &mut impl DigitalIo,
        wiring: &Wiring,
        (word, axis): (u32, u32),
        deadline: Instant,
    ) -> Result<(), Fault> {
        let confirmed = io.confirmed();
        let has_others = wiring.leaves_outputs(io.outputs());
        if confirmed.is_none() && has_others && io.tells_outputs() {
            return Err(Fault::Unsupported(
                "writing beside outputs whose levels are not known",
            ));
        }
        let (levels, next) = self.next(wiring, wiring.levels(word, axis), confirmed);
        io.write(levels, deadline)?;
        (self.latching, self.latch) = (next, levels & wiring.latch_bit());
        Ok(())
    }

    /// The levels to write, and where that leads. Lines that carry nothing keep the levels that they were found with.
    fn next(&self, wiring: &Wiring, word: u64, confirmed: Option<u64>) -> (u64, Latching) {
        let bit = wiring.latch_bit();
        let others = confirmed.unwrap_or(0) & !wiring.used_outputs();
        if bit == 0 {
            return (word | others, Latching::Taken);
        }
        let turned = match (self.latching, confirmed) {
            (Latching::Settling(levels), Some(found)) if found == levels => Some(levels ^ bit),
            // Whether it turned is not known, or it did not: nothing else may change with it.
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

    /// Takes note of what the device has confirmed since. `wrote`: whether a write was made.
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
