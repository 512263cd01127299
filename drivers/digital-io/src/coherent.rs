//! Reading lines that do not switch at the same instant.

use std::time::Instant;

use volcomp_port::{DigitalIo, Fault, InputLevels};

use crate::wiring::Wiring;

/// When a word counts as whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Coherence {
    /// Two readings one after the other agree. Lines that stay skewed for longer than a reading takes can
    /// still agree on a wrong word, and so does a port that tells one image until its next exchange (Modbus): use Gray
    /// code, a parity or a strobe.
    TwoAgree,
    /// The strobe stands at 1, before and after, and the readings agree.
    Strobe,
    /// One reading is enough: the port latches its inputs together.
    Latched,
}

/// Levels of the inputs that a word was whole on, the lines that carry nothing at 0, and when these levels came.
///
/// # Errors
/// [`Fault::TimedOut`] when no word held still before the deadline, or a fault of the port.
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
        if agrees && wiring.shown(levels).valid {
            return Ok(InputLevels { levels, taken });
        }
        before = Some(levels);
        if Instant::now() >= deadline {
            return Err(Fault::TimedOut);
        }
    }
}
