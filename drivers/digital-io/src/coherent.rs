//! Reading lines that do not switch at the same instant.

use std::time::Instant;

use volcomp_port::{DigitalIo, Fault};

use crate::wiring::Wiring;

/// When a word counts as whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Coherence {
    /// Two readings one after the other agree. Lines that stay skewed for longer than a reading takes can
    /// still agree on a wrong word: use Gray code, a parity or a strobe.
    TwoAgree,
    /// The strobe stands at 1, before and after, and the readings agree.
    Strobe,
    /// One reading is enough: the port latches its inputs together.
    Latched,
}

/// Levels of the inputs that a word was whole on.
///
/// # Errors
/// [`Fault::TimedOut`] when no word held still before the deadline, or a fault of the port.
pub fn read_coherent(
    io: &mut impl DigitalIo,
    wiring: &Wiring,
    coherence: Coherence,
    deadline: Instant,
) -> Result<u64, Fault> {
    let used = wiring.used_inputs();
    let mut before = None;
    loop {
        let levels = io.read(deadline)? & used;
        let agrees = coherence == Coherence::Latched || before == Some(levels);
        if agrees && wiring.shown(levels).valid {
            return Ok(levels);
        }
        before = Some(levels);
        if Instant::now() >= deadline {
            return Err(Fault::TimedOut);
        }
    }
}
