//! The messages that are received over one port: the last whole data of each, and the errors on the bus.

use std::time::{Duration, Instant};

use volcomp_port::Fault;

use crate::{
    frame::{AT_ONCE, CanPort, Frame, Received},
    quantity::to_internal,
    signals::{Message, Signal, SignalTable},
};

/// The errors that were noticed on the bus so far: counts of frames, and whether the controller is off the bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Health {
    /// Frames of other lengths or with a wrong checksum.
    pub broken: u64,
    /// Frames with the counter of the one before, or of an earlier one: the sender stands still, somebody repeats it, or it
    /// was overtaken on its way.
    pub repeated: u64,
    /// Counters left out: frames were lost.
    pub lost: u64,
    /// Error frames of the bus's controller.
    pub errors: u64,
    /// The controller has left the bus, and nothing came since.
    pub bus_off: bool,
}

/// A counter of 16 numbers that is so far ahead lies behind: the frame was overtaken, or doubled, on its way.
const BEHIND: u64 = 8;
/// A frame that was overtaken comes within this time of the one that overtook it. This judges no age: it tells a frame that
/// comes out of turn from the first one after a silence, in which the counter may have gone round.
const OVERTAKEN_WITHIN: Duration = Duration::from_millis(100);

/// A message that is received: the last data that were whole.
pub(crate) struct Heard {
    message: Message,
    data: [u8; 64],
    counter: Option<u64>,
    pub(crate) taken: Option<Instant>,
}

impl Heard {
    fn new(message: &Message) -> Self {
        Self {
            message: message.clone(),
            data: [0; 64],
            counter: None,
            taken: None,
        }
    }

    /// The data of the last whole frame; zeros before it.
    pub(crate) fn data(&self) -> &[u8] {
        &self.data[..self.message.length]
    }

    /// The counter of the last whole frame, where the message has one.
    pub(crate) fn counter(&self) -> Option<u64> {
        self.counter
    }

    /// Whether the last whole frame came no longer than this before another one.
    fn came_before(&self, other: Instant, within: Duration) -> bool {
        self.taken
            .is_some_and(|taken| other.saturating_duration_since(taken) <= within)
    }

    /// Takes a frame of this message. Whether it was whole and new.
    fn hear(&mut self, frame: &Frame, taken: Instant, health: &mut Health) -> bool {
        if !self.message.is_whole(frame.data()) {
            health.broken += 1;
            return false;
        }
        if let (Some(before), Some(now)) = (self.counter, self.message.counter(frame.data())) {
            match (now + 16 - before % 16) % 16 {
                0 => {
                    health.repeated += 1;
                    return false;
                }
                // After a silence nothing tells how far the counter went.
                ahead if ahead >= BEHIND && self.came_before(taken, OVERTAKEN_WITHIN) => {
                    health.repeated += 1;
                    return false;
                }
                ahead => health.lost += ahead - 1,
            }
        }
        self.counter = self.message.counter(frame.data());
        self.data[..self.message.length].copy_from_slice(frame.data());
        self.taken = Some(taken);
        true
    }
}

/// Everything that is received over one port.
pub(crate) struct Ears<P> {
    pub(crate) port: P,
    heard: Vec<Heard>,
    pub(crate) health: Health,
}

impl<P: CanPort> Ears<P> {
    /// Listens for these messages.
    pub(crate) fn new(port: P, heard: Vec<Heard>) -> Self {
        Self {
            port,
            heard,
            health: Health::default(),
        }
    }

    /// The message that holds a signal.
    pub(crate) fn heard(&self, place: &Place) -> &Heard {
        &self.heard[place.heard]
    }

    /// Takes what there is; waits for one frame until the deadline where `wait`. Whether one came. `whole` is called with
    /// each message that was whole and new, among all of them.
    pub(crate) fn listen(
        &mut self,
        deadline: Instant,
        wait: bool,
        mut whole: impl FnMut(&[Heard], usize),
    ) -> Result<bool, Fault> {
        let mut came = false;
        let until = if wait { deadline } else { Instant::now() };
        for _ in 0..AT_ONCE {
            let until = if came { Instant::now() } else { until };
            match self.port.receive(until)? {
                None => break,
                Some(Received::Error) => self.health.errors += 1,
                Some(Received::BusOff) => {
                    self.health.errors += 1;
                    self.health.bus_off = true;
                }
                Some(Received::Frame(frame, taken)) => {
                    self.health.bus_off = false;
                    let same = |heard: &Heard| {
                        let message = &heard.message;
                        (message.id, message.extended) == (frame.id, frame.extended)
                    };
                    if let Some(index) = self.heard.iter().position(same) {
                        if self.heard[index].hear(&frame, taken, &mut self.health) {
                            whole(&self.heard, index);
                        }
                        came = true;
                    }
                }
            }
        }
        Ok(came)
    }
}

/// Where a signal is: which message that is heard, and it itself.
#[derive(Clone)]
pub(crate) struct Place {
    pub(crate) heard: usize,
    pub(crate) signal: Signal,
    /// The factor from the unit of the signal to mm, rad or °C.
    pub(crate) to_internal: f64,
}

/// Adds the message of a signal to those that are heard.
///
/// # Errors
/// A unit that the quantity of the signal does not have. [`SignalTable::parse`] refuses it already; a table may come from
/// elsewhere.
pub(crate) fn hear(
    table: &SignalTable,
    heard: &mut Vec<Heard>,
    (message, place): (usize, usize),
) -> Result<Place, String> {
    let message = &table.messages[message];
    let signal = message.signals[place].clone();
    let to_internal = to_internal(&signal.name, &signal.unit)
        .map_err(|unit| format!("signal {}: {unit}", signal.name))?;
    let known = heard.iter().position(|h| h.message.name == message.name);
    let index = known.unwrap_or_else(|| {
        heard.push(Heard::new(message));
        heard.len() - 1
    });
    Ok(Place {
        heard: index,
        to_internal,
        signal,
    })
}
