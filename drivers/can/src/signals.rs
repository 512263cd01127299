//! A DBC file as a flat table: which bits of which frame are which number.

use can_dbc::{ByteOrder, Dbc, MessageId, MultiplexIndicator, ValueType};
use volcomp_vocabulary::{AxisName, Displacement};

use crate::{frame::Frame, quantity::Quantity};

/// A DBC file that cannot be used.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum DbcError {
    /// The text is no DBC file.
    #[error("{file}: {message}")]
    Syntax {
        /// The name of the DBC file.
        file: String,
        /// The message of the parser, which says where the text is wrong.
        message: String,
    },
    /// A message or signal cannot be used.
    #[error("{file}:{line}: {place}: found {found}, expected {expected}")]
    Entry {
        /// The name of the DBC file.
        file: String,
        /// The line of the message or signal, from 1.
        line: usize,
        /// The name of the message, for a signal followed by a dot and its name.
        place: String,
        /// The entry or value that was found in the file.
        found: String,
        /// The entry or value that was expected in its place.
        expected: String,
    },
}

/// An error in a message or signal whose line in the file is not known yet.
struct Wrong {
    place: String,
    found: String,
    expected: String,
}

/// A number in the data of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Signal {
    /// The name of the signal, without that of its message.
    pub name: String,
    /// Its unit as the file has it.
    pub unit: String,
    /// Whether it is signed.
    pub signed: bool,
    /// Number of its bits, 1 to 64.
    pub bits: u32,
    /// Value = raw · factor + offset.
    pub factor: f64,
    /// The offset in the unit of the signal, added to raw · factor.
    pub offset: f64,
    big_endian: bool,
    /// Place of the lowest bit: little-endian counted up through the bytes, big-endian with bytes turned
    /// round in the whole message.
    shift: u32,
}

/// A message of the DBC file: the layout of the frames with one identifier.
#[derive(Clone, Debug, PartialEq)]
pub struct Message {
    /// The name of the message in the file.
    pub name: String,
    /// Identifier of its frames.
    pub id: u32,
    /// Whether that has 29 bits.
    pub extended: bool,
    /// Bytes of data: up to 8 classic, more FD.
    pub length: usize,
    /// The signals in the data of the message.
    pub signals: Vec<Signal>,
    counter: Option<usize>,
    checksum: Option<usize>,
}

/// All messages of a file.
#[derive(Clone, Debug, PartialEq)]
pub struct SignalTable {
    /// All messages of the file, each with its signals.
    pub messages: Vec<Message>,
}

impl SignalTable {
    /// Takes the text of a DBC file that has no name.
    ///
    /// # Errors
    /// See [`SignalTable::parse_file`].
    pub fn parse(text: &str) -> Result<Self, DbcError> {
        Self::parse_file("DBC", text)
    }

    /// Takes the text of `file`.
    ///
    /// # Errors
    /// No DBC file, signals outside their message, lengths that no frame has, and a unit that is missing or that the
    /// quantity of the signal does not have: positions and corrections of linear axes are in mm or um, of rotary axes
    /// in deg, rad or urad, temperatures in degC.
    pub fn parse_file(file: &str, text: &str) -> Result<Self, DbcError> {
        let dbc = Dbc::try_from(text).map_err(|e| DbcError::Syntax {
            file: file.to_owned(),
            message: e.to_string(),
        })?;
        Self::from_dbc(&dbc).map_err(|wrong| DbcError::Entry {
            file: file.to_owned(),
            line: line_of(text, &wrong.place),
            place: wrong.place,
            found: wrong.found,
            expected: wrong.expected,
        })
    }

    fn from_dbc(dbc: &Dbc) -> Result<Self, Wrong> {
        let messages = dbc.messages.iter().filter(|m| m.size > 0).map(message);
        let messages = messages.collect::<Result<Vec<_>, _>>()?;
        for (index, message) in messages.iter().enumerate() {
            let same = |other: &&Message| {
                (other.id, other.extended) == (message.id, message.extended)
                    || other.name == message.name
            };
            if let Some(other) = messages[..index].iter().find(same) {
                let found = format!("the identifier or name of {}", other.name);
                return Err(wrong(&message.name, &found, "one of its own"));
            }
        }
        Ok(Self { messages })
    }

    /// The message of a frame.
    pub fn message_of(&self, frame: &Frame) -> Option<usize> {
        self.messages
            .iter()
            .position(|m| (m.id, m.extended) == (frame.id, frame.extended))
    }

    /// Message and place of a signal.
    pub fn find(&self, signal: &str) -> Option<(usize, usize)> {
        self.messages
            .iter()
            .enumerate()
            .find_map(|(index, message)| {
                let place = message.signals.iter().position(|s| s.name == signal)?;
                Some((index, place))
            })
    }
}

fn wrong(place: &str, found: &str, expected: &str) -> Wrong {
    Wrong {
        place: place.to_owned(),
        found: found.to_owned(),
        expected: expected.to_owned(),
    }
}

/// The line of a message, or of a signal within its message; 1 where it cannot be found.
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

fn message(found: &can_dbc::Message) -> Result<Message, Wrong> {
    let (id, extended) = match found.id {
        MessageId::Standard(id) => (u32::from(id), false),
        MessageId::Extended(id) => (id, true),
    };
    let length = usize::try_from(found.size).unwrap_or(usize::MAX);
    if Frame::new(id, extended, true, &[0; 64][..length.min(64)]).is_none() || length > 64 {
        let size = format!("identifier {id} and {length} bytes");
        return Err(wrong(
            &found.name,
            &size,
            "an identifier and a length that frames have",
        ));
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
    Ok(Message {
        name: found.name.clone(),
        id,
        extended,
        length,
        counter,
        checksum,
        signals,
    })
}

fn signal(message: &str, length: usize, found: &can_dbc::Signal) -> Result<Signal, Wrong> {
    let place = format!("{message}.{}", found.name);
    if found.multiplexer_indicator != MultiplexIndicator::Plain {
        return Err(wrong(&place, "a multiplexed signal", "a plain one"));
    }
    if !(found.factor.is_finite() && found.offset.is_finite()) || found.factor == 0.0 {
        let factor = format!("factor {} and offset {}", found.factor, found.offset);
        return Err(wrong(&place, &factor, "finite numbers, the factor not 0"));
    }
    if let Some(quantity) = Quantity::of_signal(&found.name)
        && quantity.factor(&found.unit).is_none()
    {
        let unit = match &*found.unit {
            "" => "no unit".to_owned(),
            other => format!("the unit `{other}`"),
        };
        return Err(wrong(&place, &unit, quantity.expected()));
    }
    let all = u32::try_from(8 * length).unwrap_or(0);
    let bits = u32::try_from(found.size).unwrap_or(u32::MAX);
    let start = u32::try_from(found.start_bit).unwrap_or(u32::MAX);
    let big_endian = found.byte_order == ByteOrder::BigEndian;
    // A big-endian signal starts at its highest bit, counted within its byte from the right.
    let shift = if big_endian {
        let from_left = (start / 8).saturating_mul(8).saturating_add(7 - start % 8);
        all.checked_sub(from_left.saturating_add(bits))
    } else {
        all.checked_sub(start.saturating_add(bits)).map(|_| start)
    };
    let Some(shift) = shift.filter(|_| (1..=64).contains(&bits)) else {
        let found = format!("{bits} bits from {start} on");
        return Err(wrong(&place, &found, &format!("1 to 64 bits within {all}")));
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

impl Signal {
    /// Byte `k` from the end that holds the lowest bits; past the data where these are too short.
    #[inline]
    fn byte(&self, length: usize, k: usize) -> usize {
        if self.big_endian {
            length.wrapping_sub(k + 1)
        } else {
            k
        }
    }

    /// The bits as they stand in the data.
    #[inline]
    pub fn raw(&self, data: &[u8]) -> u64 {
        let (first, within) = ((self.shift / 8) as usize, self.shift % 8);
        let bytes = ((within + self.bits).div_ceil(8)) as usize;
        let mut wide = 0_u128;
        for k in 0..bytes {
            let byte = data
                .get(self.byte(data.len(), first + k))
                .copied()
                .unwrap_or(0);
            wide |= u128::from(byte) << (8 * k);
        }
        #[expect(
            clippy::cast_possible_truncation,
            reason = "64 bits at the most are left"
        )]
        let raw = (wide >> within) as u64;
        raw & (u64::MAX >> (64 - self.bits))
    }

    /// The value: signed where it is, scaled.
    #[inline]
    #[expect(clippy::cast_precision_loss, reason = "as precise as a number can be")]
    pub fn value(&self, data: &[u8]) -> f64 {
        let raw = self.raw(data);
        let number = if self.signed {
            let up = 64 - self.bits;
            ((raw << up).cast_signed() >> up) as f64
        } else {
            raw as f64
        };
        number * self.factor + self.offset
    }

    /// Puts bits into the data.
    #[inline]
    pub fn put_raw(&self, data: &mut [u8], raw: u64) {
        let (first, within) = ((self.shift / 8) as usize, self.shift % 8);
        let bytes = ((within + self.bits).div_ceil(8)) as usize;
        let mask = u128::from(u64::MAX >> (64 - self.bits)) << within;
        let wide = (u128::from(raw) << within) & mask;
        let length = data.len();
        for k in 0..bytes {
            if let Some(byte) = data.get_mut(self.byte(length, first + k)) {
                #[expect(
                    clippy::cast_possible_truncation,
                    reason = "the eight bits of this byte"
                )]
                let (keep, new) = (!((mask >> (8 * k)) as u8), (wide >> (8 * k)) as u8);
                *byte = *byte & keep | new;
            }
        }
    }

    /// Puts the nearest value that the bits can say; what is no number is the raw 0. Returns whether it was
    /// within the range.
    #[inline]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        clippy::cast_precision_loss,
        reason = "held within the range of the bits"
    )]
    pub fn put(&self, data: &mut [u8], value: f64) -> bool {
        let wanted = ((value - self.offset) / self.factor).round();
        let [low, high] = if self.signed {
            let half = (1_u64 << (self.bits - 1)) as f64;
            [-half, half - 1.0]
        } else {
            [0.0, (u64::MAX >> (64 - self.bits)) as f64]
        };
        let held = wanted.clamp(low, high);
        let raw = if self.signed {
            (held as i64).cast_unsigned()
        } else {
            held as u64
        };
        self.put_raw(data, raw);
        (low..=high).contains(&wanted)
    }

    /// The factor from the value to mm, rad or °C; `None` for a signal that is no position, correction or temperature.
    pub(crate) fn to_internal(&self) -> Option<f64> {
        Quantity::of_signal(&self.name)?.factor(&self.unit)
    }

    /// The axis and place that the data say, where this is the position of an axis (`X_POS`).
    pub fn position(&self, data: &[u8]) -> Option<(AxisName, Displacement)> {
        let name: AxisName = self.name.strip_suffix("_POS")?.parse().ok()?;
        let mm_or_rad = self.value(data) * self.to_internal()?;
        Some((name, Displacement::new(name.kind(), mm_or_rad)))
    }

    /// The temperature that the data say, °C, where this is one (`BED_TEMP`), with the name of its sensor in small
    /// letters.
    pub fn temperature(&self, data: &[u8]) -> Option<(String, f64)> {
        let name = self.name.strip_suffix("_TEMP")?.to_lowercase();
        Some((name, self.value(data) * self.to_internal()?))
    }

    /// The step between two values, in the unit of the signal.
    pub fn step(&self) -> f64 {
        self.factor.abs()
    }
}

impl Message {
    /// A frame of this message with all bits 0.
    pub fn frame(&self) -> Option<Frame> {
        Frame::new(
            self.id,
            self.extended,
            self.length > 8,
            &[0; 64][..self.length],
        )
    }

    /// The counter of a frame's data, where the message has one.
    pub fn counter(&self, data: &[u8]) -> Option<u64> {
        Some(self.signals[self.counter?].raw(data))
    }

    /// Whether the length and, where the message has one, the checksum of data are right.
    pub fn is_whole(&self, data: &[u8]) -> bool {
        data.len() == self.length
            && self.checksum.is_none_or(|place| {
                let signal = &self.signals[place];
                signal.raw(data) == u64::from(checksum(self.id, data, signal))
            })
    }

    /// Sets counter and checksum of data that are ready otherwise.
    pub fn seal(&self, data: &mut [u8], counter: u64) {
        if let Some(place) = self.counter {
            self.signals[place].put_raw(data, counter);
        }
        if let Some(place) = self.checksum {
            let signal = &self.signals[place];
            let sum = checksum(self.id, data, signal);
            signal.put_raw(data, u64::from(sum));
        }
    }
}

/// CRC-8 SAE J1850 (polynomial 1d, start ff, result inverted) over the identifier, four bytes, high first, and
/// the data with the bits of the checksum itself 0.
pub fn checksum(id: u32, data: &[u8], own: &Signal) -> u8 {
    let mut plain = [0; 64];
    let length = data.len().min(64);
    plain[..length].copy_from_slice(&data[..length]);
    own.put_raw(&mut plain[..length], 0);
    let head = id.to_be_bytes();
    let bytes = head.iter().chain(&plain[..length]);
    !bytes.fold(0xff, |crc, byte| CRC8[usize::from(crc ^ byte)])
}

const CRC8: [u8; 256] = {
    let mut table = [0; 256];
    let mut index = 0;
    while index < 256 {
        #[expect(clippy::cast_possible_truncation, reason = "below 256")]
        let mut crc = index as u8;
        let mut bit = 0;
        while bit < 8 {
            crc = if crc & 0x80 == 0 {
                crc << 1
            } else {
                crc << 1 ^ 0x1d
            };
            bit += 1;
        }
        table[index] = crc;
        index += 1;
    }
    table
};
