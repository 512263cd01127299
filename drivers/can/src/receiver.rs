//! Receives messages from one port, stores the last valid data of each message, and counts bus errors.

use std::time::{Duration, Instant};

use volcomp_port::Fault;

use crate::{
    frame::{CanPort, Frame, MAX_FRAMES_PER_READ, Received},
    quantity::to_internal,
    signals::{Message, Signal, SignalTable},
};

/// Bus errors since the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Health {
    /// Number of frames with a wrong length or checksum.
    pub broken: u64,
    /// Number of frames whose counter equals that of the previous frame or is older: the sender has stopped, or the
    /// frame arrived out of order.
    pub repeated: u64,
    /// Number of lost frames, from gaps in the counter.
    pub lost: u64,
    /// Number of error frames of the bus controller.
    pub errors: u64,
    /// Whether the bus controller is bus-off and no frame has arrived since.
    pub bus_off: bool,
}

/// Counters are compared modulo 16. A counter that is at least this many steps ahead counts as behind: the frame
/// arrived out of order or twice.
const MIN_STEPS_BEHIND: u64 = 8;
/// Maximum delay of a frame that arrives out of order. A frame after a longer silence always counts as new, because the
/// counter may have wrapped meanwhile. This constant does not limit the age of data.
const MAX_OVERTAKE_DELAY: Duration = Duration::from_millis(100);

pub(crate) struct ReceivedMessage {
    message: Message,
    data: [u8; 64],
    counter: Option<u64>,
    pub(crate) taken: Option<Instant>,
}

impl ReceivedMessage {
    fn new(message: &Message) -> Self {
        Self { message: message.clone(), data: [0; 64], counter: None, taken: None }
    }

    /// Data of the last valid frame; zeros before the first one.
    pub(crate) fn data(&self) -> &[u8] {
        &self.data[..self.message.length]
    }

    pub(crate) fn counter(&self) -> Option<u64> {
        self.counter
    }

    /// Whether the last valid frame arrived at most `within` before the time `other`.
    fn arrived_within(&self, other: Instant, within: Duration) -> bool {
        self.taken.is_some_and(|taken| other.saturating_duration_since(taken) <= within)
    }

    /// Processes a frame of this message. Returns whether it was valid and new.
    fn process(&mut self, frame: &Frame, taken: Instant, health: &mut Health) -> bool {
        if !self.message.is_whole(frame.data()) {
            health.broken += 1;
            return false;
        }
        if let (Some(before), Some(now)) = (self.counter, self.message.counter(frame.data())) {
            match now.wrapping_sub(before) % 16 {
                0 => {
                    health.repeated += 1;
                    return false;
                }
                // After a silence of more than `MAX_OVERTAKE_DELAY` the counter may have wrapped any number of times.
                ahead
                    if ahead >= MIN_STEPS_BEHIND
                        && self.arrived_within(taken, MAX_OVERTAKE_DELAY) =>
                {
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

pub(crate) struct Receiver<P> {
    pub(crate) port: P,
    messages: Vec<ReceivedMessage>,
    pub(crate) health: Health,
}

impl<P: CanPort> Receiver<P> {
    pub(crate) fn new(mut port: P, messages: Vec<ReceivedMessage>) -> Self {
        let id = |received: &ReceivedMessage| (received.message.id, received.message.extended);
        port.accept_only(&messages.iter().map(id).collect::<Vec<_>>());
        Self { port, messages, health: Health::default() }
    }

    pub(crate) fn message(&self, signal: &ReceivedSignal) -> &ReceivedMessage {
        &self.messages[signal.message]
    }

    /// Processes the waiting frames. If `wait` is set, waits for a frame until the deadline. Calls `whole` for each
    /// valid and new message, with all messages and the index of the new one. Returns whether a subscribed frame
    /// arrived.
    pub(crate) fn listen(
        &mut self,
        deadline: Instant,
        wait: bool,
        mut whole: impl FnMut(&[ReceivedMessage], usize),
    ) -> Result<bool, Fault> {
        let mut arrived = false;
        let until = if wait { deadline } else { Instant::now() };
        for _ in 0..MAX_FRAMES_PER_READ {
            let until = if arrived { Instant::now() } else { until };
            match self.port.receive(until)? {
                None => break,
                Some(Received::Error) => self.health.errors += 1,
                Some(Received::BusOff) => {
                    self.health.errors += 1;
                    self.health.bus_off = true;
                }
                Some(Received::Frame(frame, taken)) => {
                    self.health.bus_off = false;
                    let same = |received: &ReceivedMessage| {
                        let message = &received.message;
                        (message.id, message.extended) == (frame.id, frame.extended)
                    };
                    if let Some(index) = self.messages.iter().position(same) {
                        if self.messages[index].process(&frame, taken, &mut self.health) {
                            whole(&self.messages, index);
                        }
                        arrived = true;
                    }
                }
            }
        }
        Ok(arrived)
    }
}

#[derive(Clone)]
pub(crate) struct ReceivedSignal {
    pub(crate) message: usize,
    pub(crate) signal: Signal,
    /// Factor from the unit of the signal to mm, rad or °C.
    pub(crate) to_internal: f64,
}

/// Subscribes to the message of a signal. Errors: a unit that does not match the quantity of the signal.
/// [`SignalTable::parse`] checks the unit too, but its fields are public, so code can also build a table without this
/// check.
pub(crate) fn subscribe(
    table: &SignalTable,
    messages: &mut Vec<ReceivedMessage>,
    (message, place): (usize, usize),
) -> Result<ReceivedSignal, String> {
    let message = &table.messages[message];
    let signal = message.signals[place].clone();
    let to_internal = to_internal(&signal.name, &signal.unit)
        .map_err(|unit| format!("signal {}: {unit}", signal.name))?;
    let known = messages.iter().position(|h| h.message.name == message.name);
    let index = known.unwrap_or_else(|| {
        messages.push(ReceivedMessage::new(message));
        messages.len() - 1
    });
    Ok(ReceivedSignal { message: index, to_internal, signal })
}
