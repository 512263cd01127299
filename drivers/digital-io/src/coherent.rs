use std::time::Instant;

use volcomp_port::{DigitalIo, Fault, InputLevels};

use crate::wiring::Wiring;

/// Condition on which a position word counts as coherent, that is, with all bits from one instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Coherence {
    /// Two consecutive readings agree. Both can be wrong if the lines are skewed for longer than one reading, or if a
    /// port returns the same image until its next exchange (Modbus). In these cases use Gray code, a parity or a
    /// strobe.
    TwoAgree,
    /// Two consecutive readings agree, and the strobe is 1 in both.
    Strobe,
    /// A single reading suffices, because the port latches its inputs together.
    Latched,
}

/// Reads the inputs until the word is coherent. Returns the levels, with unused lines set to 0, and the time of the
/// reading.
///
/// # Errors
/// [`Fault::TimedOut`] if no word was stable before the deadline, or a fault of the port.
pub fn read_coherent(
    io: &mut impl DigitalIo,
    wiring: &Wiring,
    coherence: Coherence,
    deadline: Instant,
) -> Result<InputLevels, Fault> {
    let used = wiring.used_inputs();
    let mut before = None;
    loop {
        let InputLevels { levels, taken } = io.read(deadline)?;
        let levels = levels & used;
        let agrees = coherence == Coherence::Latched || before == Some(levels);
        if agrees && wiring.position_input(levels).valid {
            return Ok(InputLevels { levels, taken });
        }
        before = Some(levels);
        if Instant::now() >= deadline {
            return Err(Fault::TimedOut);
        }
    }
}
