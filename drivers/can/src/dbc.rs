use can_dbc::{ByteOrder, Dbc, MessageId, MultiplexIndicator, SignalExtendedValueType, ValueType};

use crate::{
    frame::Frame,
    quantity::{Quantity, STATES, to_internal},
    signals::{Message, Signal, SignalTable},
};

/// Minimum size of a counter of frames: 16 steps distinguish frames that were lost from frames out of order.
const COUNTER_BITS: u32 = 4;

/// Errors of a DBC file.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DbcError {
    /// The text is not a DBC file.
    #[error("{file}: {message}")]
    Syntax {
        /// Name of the file, for messages.
        file: String,
        /// Message of the parser, with the position of the error.
        message: String,
    },
    /// A message or signal is invalid.
    #[error("{file}:{line}: {place}: found {found}, expected {expected}")]
    Entry {
        /// Name of the file, for messages.
        file: String,
        /// Line of the message or signal, from 1.
        line: usize,
        /// Name of the message. For a signal: name of the message, a dot, and name of the signal.
        place: String,
        found: String,
        expected: String,
    },
}

/// An error in a message or signal, without its line in the file.
struct Defect {
    place: String,
    found: String,
    expected: String,
}

impl SignalTable {
    /// Parses the text of a DBC file. Error messages name the file `DBC`.
    ///
    /// # Errors
    /// See [`SignalTable::parse_file`].
    pub fn parse(text: &str) -> Result<Self, DbcError> {
        Self::parse_file("DBC", text)
    }

    /// Parses the text of a DBC file. `file` is its name in error messages.
    ///
    /// # Errors
    /// Text that is not a DBC file, a signal outside its message, an invalid frame length, or a unit that is missing or
    /// does not match the quantity of the signal. Two positions, corrections, temperatures or states with the same
    /// signal name, because either could be meant. Valid units: mm or um for positions and corrections of linear axes;
    /// deg, rad or urad for rotary axes; degC for temperatures; none or `bool` for the states of the control.
    pub fn parse_file(file: &str, text: &str) -> Result<Self, DbcError> {
        let dbc = Dbc::try_from(text)
            .map_err(|e| DbcError::Syntax { file: file.to_owned(), message: e.to_string() })?;
        Self::from_dbc(&dbc).map_err(|defect| DbcError::Entry {
            file: file.to_owned(),
            line: line_of(text, &defect.place),
            place: defect.place,
            found: defect.found,
            expected: defect.expected,
        })
    }

    fn from_dbc(dbc: &Dbc) -> Result<Self, Defect> {
        let used = || dbc.messages.iter().filter(|m| m.size > 0);
        let messages = used().map(message).collect::<Result<Vec<_>, _>>()?;
        for (found, message) in used().zip(&messages) {
            check_signals(dbc, found.id, message)?;
        }
        for (index, message) in messages.iter().enumerate() {
            let same = |other: &&Message| {
                (other.id, other.extended) == (message.id, message.extended)
                    || other.name == message.name
            };
            if let Some(other) = messages[..index].iter().find(same) {
                let found = format!("the identifier or name of {}", other.name);
                return Err(defect(&message.name, &found, "a unique one"));
            }
            check_names(message, &messages[..index])?;
        }
        Ok(Self { messages })
    }
}

/// Checks that no used signal of a message has the name of another signal, in this message or in the messages before it.
fn check_names(message: &Message, before: &[Message]) -> Result<(), Defect> {
    for (index, signal) in message.signals.iter().enumerate() {
        let of_message = message.signals[..index].iter().map(|other| (message, other));
        let of_others =
            before.iter().flat_map(|other| other.signals.iter().map(move |s| (other, s)));
        let mut all = of_message.chain(of_others);
        let is_used = Quantity::of_signal(&signal.name).is_some();
        if let Some((other, _)) = all.find(|(_, other)| is_used && other.name == signal.name) {
            let place = format!("{}.{}", message.name, signal.name);
            let found = format!("the name of a signal of {}", other.name);
            return Err(defect(&place, &found, "a unique one"));
        }
    }
    Ok(())
}

/// Checks the used signals of a message: each is an integer that shares no bits with others, a counter has at least
/// [`COUNTER_BITS`], and all bits 0 mean that a state is off.
fn check_signals(dbc: &Dbc, id: MessageId, message: &Message) -> Result<(), Defect> {
    for (index, signal) in message.signals.iter().enumerate() {
        let is_word = ["FRAME_", "REPORT_"].map(|prefix| signal.name.starts_with(prefix));
        let is_of_message = [message.counter, message.checksum].contains(&Some(index));
        let is_used = Quantity::of_signal(&signal.name).is_some() || is_word.contains(&true);
        if !(is_used || is_of_message) {
            continue;
        }
        let place = format!("{}.{}", message.name, signal.name);
        let others = message.signals.iter().enumerate();
        let mut others = others.filter(|(other, _)| *other != index);
        if let Some((_, other)) =
            others.find(|(_, other)| signal.shares_bits(other, message.length))
        {
            let found = format!("bits shared with {}", other.name);
            return Err(defect(&place, &found, "separate bits"));
        }
        let kind = dbc.extended_value_type_for_signal(id, &signal.name);
        if kind.is_some_and(|kind| *kind != SignalExtendedValueType::SignedOrUnsignedInteger) {
            return Err(defect(&place, "a floating-point number", "a whole number"));
        }
        if message.counter == Some(index) && signal.bits < COUNTER_BITS {
            let found = format!("{} bits", signal.bits);
            let expected = format!("at least {COUNTER_BITS}: the counter runs from 0 to 15");
            return Err(defect(&place, &found, &expected));
        }
        if STATES.contains(&&*signal.name) && signal.offset != 0.0 {
            let found = format!("the offset {}", signal.offset);
            return Err(defect(&place, &found, "0: bits 0 must mean off"));
        }
    }
    Ok(())
}

fn defect(place: &str, found: &str, expected: &str) -> Defect {
    Defect { place: place.to_owned(), found: found.to_owned(), expected: expected.to_owned() }
}

/// Line of a message, or of a signal within its message, counted from 1. Returns 1 if the message or signal is not
/// found.
fn line_of(text: &str, place: &str) -> usize {
    let (message, signal) = match place.split_once('.') {
        Some((message, signal)) => (message, Some(signal)),
        None => (place, None),
    };
    let mut within = false;
    for (index, line) in text.lines().enumerate() {
        let mut words = line.split([' ', '\t', ':']).filter(|word| !word.is_empty());
        match (words.next(), signal) {
            (Some("BO_"), _) => {
                within = words.nth(1) == Some(message);
                if within && signal.is_none() {
                    return index + 1;
                }
            }
            (Some("SG_"), Some(signal)) if within && words.next() == Some(signal) => {
                return index + 1;
            }
            _ => {}
        }
    }
    1
}

fn message(found: &can_dbc::Message) -> Result<Message, Defect> {
    let (id, extended) = match found.id {
        MessageId::Standard(id) => (u32::from(id), false),
        MessageId::Extended(id) => (id, true),
    };
    let length = usize::try_from(found.size).unwrap_or(usize::MAX);
    if Frame::new(id, extended, true, &[0; 64][..length.min(64)]).is_none() || length > 64 {
        let size = format!("identifier {id} and {length} bytes");
        return Err(defect(&found.name, &size, "a valid identifier and length of a frame"));
    }
    let signals = found
        .signals
        .iter()
        .map(|s| signal(&found.name, length, s))
        .collect::<Result<Vec<_>, _>>()?;
    let named = |suffix: &str| {
        let name = format!("{}{suffix}", found.name);
        signals.iter().position(|s: &Signal| s.name == name)
    };
    let (counter, checksum) = (named("_CNT"), named("_CRC"));
    Ok(Message { name: found.name.clone(), id, extended, length, counter, checksum, signals })
}

fn signal(message: &str, length: usize, found: &can_dbc::Signal) -> Result<Signal, Defect> {
    let place = format!("{message}.{}", found.name);
    if found.multiplexer_indicator != MultiplexIndicator::Plain {
        return Err(defect(&place, "a multiplexed signal", "a plain one"));
    }
    if !(found.factor.is_finite() && found.offset.is_finite()) || found.factor == 0.0 {
        let factor = format!("factor {} and offset {}", found.factor, found.offset);
        return Err(defect(&place, &factor, "finite numbers and a nonzero factor"));
    }
    if let Err(unit) = to_internal(&found.name, &found.unit) {
        return Err(defect(&place, &unit.found, unit.expected));
    }
    let all = u32::try_from(8 * length).unwrap_or(0);
    let bits = u32::try_from(found.size).unwrap_or(u32::MAX);
    let start = u32::try_from(found.start_bit).unwrap_or(u32::MAX);
    let big_endian = found.byte_order == ByteOrder::BigEndian;
    // The start bit of a big-endian signal is its highest bit. Bits within a byte are numbered from the right.
    let shift = if big_endian {
        let from_left = (start / 8).saturating_mul(8).saturating_add(7 - start % 8);
        all.checked_sub(from_left.saturating_add(bits))
    } else {
        all.checked_sub(start.saturating_add(bits)).map(|_| start)
    };
    let Some(shift) = shift.filter(|_| (1..=64).contains(&bits)) else {
        let found = format!("{bits} bits from {start} on");
        return Err(defect(&place, &found, &format!("1 to 64 bits within {all}")));
    };
    Ok(Signal {
        name: found.name.clone(),
        unit: found.unit.clone(),
        signed: found.value_type == ValueType::Signed,
        bits,
        factor: found.factor,
        offset: found.offset,
        big_endian,
        shift,
    })
}
