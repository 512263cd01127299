//! Converts registers to a temperature as a profile describes.

use std::time::Instant;

use volcomp_port::{Reason, Temperature};
use volcomp_vocabulary::bounds::is_plausible_reading;

use crate::{
    iec60751,
    profile::{ByteOrder, Channels, NumberType, Unit, WordOrder},
};

/// Decodes the temperature of channel `channel`, counted from 0. `registers` starts with the first channel. `status`
/// has the fault bits of this channel, or is `None` if the module has no fault bits. The temperature is bad in each of
/// these cases:
/// - The module reports a fault code or a fault bit.
/// - The value is not a number, or a float that no thermometer sends.
/// - The value is at or beyond an end of the module's range.
/// - Registers are missing.
pub fn read_channel(
    channels: &Channels,
    registers: &[u16],
    channel: usize,
    status: Option<u16>,
    taken: Instant,
) -> Temperature {
    let width = usize::from(channels.number.registers());
    let words = channel.checked_mul(width).and_then(|first| registers.get(first..)?.get(..width));
    match words.and_then(|words| number(channels, words)) {
        Some(raw) => temperature(channels, raw, status, taken),
        None => Temperature::bad(Reason::NotANumber, taken),
    }
}

fn number(channels: &Channels, words: &[u16]) -> Option<f64> {
    let wide = || {
        let [first, second] = *words else { return None };
        let [first, second] = match channels.byte_order {
            ByteOrder::HighFirst => [first, second],
            ByteOrder::LowFirst => [first, second].map(u16::swap_bytes),
        };
        let [high, low] = match channels.word_order {
            WordOrder::HighFirst => [first, second],
            WordOrder::LowFirst => [second, first],
        };
        Some(u32::from(high) << 16 | u32::from(low))
    };
    Some(match channels.number {
        NumberType::I16 => f64::from(words.first()?.cast_signed()),
        NumberType::U16 => f64::from(*words.first()?),
        NumberType::I32 => f64::from(wide()?.cast_signed()),
        NumberType::F32 => f64::from(f32::from_bits(wide()?)),
    })
}

fn temperature(channels: &Channels, raw: f64, status: Option<u16>, taken: Instant) -> Temperature {
    let encodes = |fault: &&crate::profile::Fault| {
        let [low, high] = fault.raw;
        (low..=high).contains(&raw)
    };
    if let Some(fault) = channels.faults.iter().find(encodes) {
        return Temperature::bad(fault.reason, taken);
    }
    if status.is_some_and(|bits| bits != 0) {
        return Temperature::bad(Reason::Reported, taken);
    }
    if channels.number == NumberType::F32 && raw.is_finite() && !is_plausible_reading(raw) {
        return Temperature::bad(Reason::Implausible, taken);
    }
    let value = raw * channels.scale + channels.offset;
    let degc = match channels.unit {
        Unit::Degc => Some(value),
        Unit::Ohm { r0_ohm, leads_ohm } => iec60751::two_wire(value, leads_ohm, r0_ohm),
    };
    let [low, high] = channels.valid_degc;
    match degc {
        None if value.is_nan() => Temperature::bad(Reason::NotANumber, taken),
        // The resistance is outside the range of the standard, because of an open circuit or a short circuit.
        None if value > 100.0 => Temperature::bad(Reason::Open, taken),
        None => Temperature::bad(Reason::Short, taken),
        // Modules clamp values to the ends of their range, so a value at an end is not a reliable temperature.
        Some(degc) if degc <= low => Temperature::bad(Reason::Short, taken),
        Some(degc) if degc >= high => Temperature::bad(Reason::Open, taken),
        Some(degc) => Temperature::good(degc, taken),
    }
}
