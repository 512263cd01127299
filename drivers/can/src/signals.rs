//! Signals in the data of frames: bit positions, scaling and access to values.

use volcomp_vocabulary::{AxisName, Displacement};

use crate::{frame::Frame, quantity::Quantity};

/// A number in the data of a frame, with value = raw · `factor` + `offset`.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Signal {
    /// Name of the signal, without the name of its message.
    pub name: String,
    /// Unit, as written in the DBC file.
    pub unit: String,
    pub signed: bool,
    /// Number of bits, 1 to 64.
    pub bits: u32,
    /// Value of one raw count, in the unit of the signal.
    pub factor: f64,
    /// Value at raw 0, in the unit of the signal.
    pub offset: f64,
    pub(crate) big_endian: bool,
    /// Position of the lowest bit. Little-endian: counted from bit 0 of the first byte. Big-endian: counted in the same
    /// way after the byte order of the message is reversed.
    pub(crate) shift: u32,
}

/// A message of the DBC file: the layout of the frames with one identifier.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Message {
    /// Name of the message in the file.
    pub name: String,
    pub id: u32,
    /// Whether `id` has 29 bits.
    pub extended: bool,
    /// Number of data bytes: up to 8 in classic frames, more in FD frames.
    pub length: usize,
    pub signals: Vec<Signal>,
    /// Index of the signal that counts the frames; `None` if the message has no counter.
    pub(crate) counter: Option<usize>,
    /// Index of the signal with the checksum; `None` if the message has no checksum.
    pub(crate) checksum: Option<usize>,
}

/// The messages of a DBC file.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct SignalTable {
    pub messages: Vec<Message>,
}

impl SignalTable {
    /// Index of the message to which a frame belongs.
    pub fn message_of(&self, frame: &Frame) -> Option<usize> {
        self.messages.iter().position(|m| (m.id, m.extended) == (frame.id, frame.extended))
    }

    /// Index of the message that contains a signal, and index of the signal within that message.
    pub fn find(&self, signal: &str) -> Option<(usize, usize)> {
        self.messages.iter().enumerate().find_map(|(index, message)| {
            let place = message.signals.iter().position(|s| s.name == signal)?;
            Some((index, place))
        })
    }
}

impl Signal {
    /// Index in the data of byte `k` of the message, counted from the byte with the lowest bits. The index is past the
    /// end if the data are too short.
    #[inline]
    fn byte(&self, length: usize, k: usize) -> usize {
        if self.big_endian { length.wrapping_sub(k + 1) } else { k }
    }

    /// Raw bits of the signal in the data. Bits beyond the end of the data are 0.
    #[inline]
    pub fn raw(&self, data: &[u8]) -> u64 {
        let (first, within) = ((self.shift / 8) as usize, self.shift % 8);
        let bytes = ((within + self.bits).div_ceil(8)) as usize;
        let mut wide = 0_u128;
        for k in 0..bytes {
            let byte = data.get(self.byte(data.len(), first + k)).copied().unwrap_or(0);
            wide |= u128::from(byte) << (8 * k);
        }
        #[expect(clippy::cast_possible_truncation, reason = "at most 64 bits are left")]
        let raw = (wide >> within) as u64;
        raw & (u64::MAX >> (64 - self.bits))
    }

    /// Value of the signal in the data, in the unit of the signal.
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

    /// Writes the raw bits of the signal into the data.
    #[inline]
    pub fn put_raw(&self, data: &mut [u8], raw: u64) {
        let (first, within) = ((self.shift / 8) as usize, self.shift % 8);
        let bytes = ((within + self.bits).div_ceil(8)) as usize;
        let mask = u128::from(u64::MAX >> (64 - self.bits)) << within;
        let wide = (u128::from(raw) << within) & mask;
        let length = data.len();
        for k in 0..bytes {
            if let Some(byte) = data.get_mut(self.byte(length, first + k)) {
                #[expect(clippy::cast_possible_truncation, reason = "the eight bits of this byte")]
                let (keep, new) = (!((mask >> (8 * k)) as u8), (wide >> (8 * k)) as u8);
                *byte = *byte & keep | new;
            }
        }
    }

    /// Writes the nearest representable value; NaN becomes 0. Returns whether the value was in range.
    #[inline]
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "held within the range of the bits"
    )]
    pub fn put(&self, data: &mut [u8], value: f64) -> bool {
        let is_number = !value.is_nan();
        let value = if is_number { value } else { 0.0 };
        let scaled = ((value - self.offset) / self.factor).round();
        let [low, high] = self.raw_range();
        let held = scaled.clamp(low, high);
        let raw = if self.signed { (held as i64).cast_unsigned() } else { held as u64 };
        self.put_raw(data, raw);
        is_number && (low..=high).contains(&scaled)
    }

    /// Whether two signals share a bit in data of `length` bytes.
    pub(crate) fn shares_bits(&self, other: &Self, length: usize) -> bool {
        let bits = |signal: &Self| {
            let mut data = [0; 64];
            signal.put_raw(&mut data[..length.min(64)], u64::MAX);
            data
        };
        let both = bits(self).into_iter().zip(bits(other));
        both.into_iter().any(|(one, two)| one & two != 0)
    }

    /// Factor from the unit of the signal to mm, rad or °C; `None` for a signal that is not a position, correction,
    /// temperature or state.
    pub(crate) fn to_internal(&self) -> Option<f64> {
        Quantity::of_signal(&self.name)?.factor(&self.unit).ok()
    }

    /// Axis and position in the data; `None` if this is not a position signal (`X_POS`).
    pub fn position(&self, data: &[u8]) -> Option<(AxisName, Displacement)> {
        let name: AxisName = self.name.strip_suffix("_POS")?.parse().ok()?;
        let mm_or_rad = self.value(data) * self.to_internal()?;
        Some((name, Displacement::new(name.kind(), mm_or_rad)))
    }

    /// Name of the sensor in lower case, and its temperature in the data, °C; `None` if this is not a temperature
    /// signal (`BED_TEMP`).
    pub fn temperature(&self, data: &[u8]) -> Option<(String, f64)> {
        let name = self.name.strip_suffix("_TEMP")?.to_lowercase();
        Some((name, self.value(data) * self.to_internal()?))
    }

    #[inline]
    #[expect(clippy::cast_precision_loss, reason = "as precise as a number can be")]
    fn raw_range(&self) -> [f64; 2] {
        if self.signed {
            let half = (1_u64 << (self.bits - 1)) as f64;
            [-half, half - 1.0]
        } else {
            [0.0, (u64::MAX >> (64 - self.bits)) as f64]
        }
    }

    /// Raw bits of the lowest and the highest number that the signal can represent.
    pub(crate) fn raw_ends(&self) -> [u64; 2] {
        let all = u64::MAX >> (64 - self.bits);
        if self.signed { [all / 2 + 1, all / 2] } else { [0, all] }
    }

    /// Largest magnitude that the signal can represent with either sign, in the unit of the signal; 0 if the signal can
    /// represent only one sign.
    pub fn largest(&self) -> f64 {
        let [a, b] = self.raw_range().map(|raw| raw * self.factor + self.offset);
        a.max(b).min(-a.min(b)).max(0.0)
    }

    /// Difference between adjacent values, in the unit of the signal.
    pub fn step(&self) -> f64 {
        self.factor.abs()
    }
}

impl Message {
    /// Creates a frame of this message with all bits 0; `None` if the length of the message is invalid.
    pub fn frame(&self) -> Option<Frame> {
        Frame::new(self.id, self.extended, self.length > 8, &[0; 64][..self.length])
    }

    /// Counter in the data of a frame; `None` if the message has no counter.
    pub fn counter(&self, data: &[u8]) -> Option<u64> {
        Some(self.signals[self.counter?].raw(data))
    }

    /// Whether the length of the data is correct and, if the message has a checksum, the checksum too.
    pub fn is_whole(&self, data: &[u8]) -> bool {
        data.len() == self.length
            && self.checksum.is_none_or(|place| {
                let signal = &self.signals[place];
                signal.raw(data) == u64::from(checksum(self.id, data, signal))
            })
    }

    /// Sets counter and checksum. Call this after all other signals are set.
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

/// CRC-8 SAE J1850 (polynomial 1d, initial value ff, result inverted) over the identifier (four bytes, high byte first)
/// and the data. The bits of the checksum signal `own` count as 0.
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
            crc = if crc & 0x80 == 0 { crc << 1 } else { crc << 1 ^ 0x1d };
            bit += 1;
        }
        table[index] = crc;
        index += 1;
    }
    table
};
