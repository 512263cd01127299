//! From registers to a temperature, by a profile.

use std::time::Instant;

use volcomp_port::{Reason, Temperature};

use crate::{
    iec60751,
    profile::{Channels, NumberType, Unit, WordOrder},
};

/// A channel's number before it is scaled.
pub type Raw = f64;

/// One channel among the registers that were read from the first channel's on. `status`: its fault bits,
/// where the module tells them.
pub fn read_channel(
    channels: &Channels,
    registers: &[u16],
    channel: usize,
    status: Option<u16>,
    taken: Instant,
) -> (Option<Raw>, Temperature) {
    let width = usize::from(channels.number.registers());
    let words = registers.get(channel * width..(channel + 1) * width);
    let Some(raw) = words.and_then(|words| number(channels, words)) else {
        return (None, Temperature::bad(Reason::NotANumber, taken));
    };
    (Some(raw), judge(channels, raw, status, taken))
}

fn number(channels: &Channels, words: &[u16]) -> Option<Raw> {
    let wide = || {
        let [first, second] = *words else { return None };
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

fn judge(channels: &Channels, raw: Raw, status: Option<u16>, taken: Instant) -> Temperature {
    let stands_for = |fault: &&crate::profile::Fault| {
        let [low, high] = fault.raw;
        (low..=high).contains(&raw)
    };
    if let Some(fault) = channels.faults.iter().find(stands_for) {
        return Temperature::bad(fault.reason, taken);
    }
    if status.is_some_and(|bits| bits != 0) {
        return Temperature::bad(Reason::Reported, taken);
    }
    let value = raw * channels.scale + channels.offset;
    let degc = match channels.unit {
        Unit::Degc => Some(value),
        Unit::Ohm { r0_ohm, leads_ohm } => iec60751::two_wire(value, leads_ohm, r0_ohm),
    };
    let [low, high] = channels.valid_degc;
    match degc {
        None if value.is_nan() => Temperature::bad(Reason::NotANumber, taken),
        // A resistance beyond the standard's range: a broken wire or a short one.
        None if value > 100.0 => Temperature::bad(Reason::Open, taken),
        None => Temperature::bad(Reason::Short, taken),
        // At the ends of the range modules clamp: what stands there is not known to be a temperature.
        Some(degc) if degc <= low => Temperature::bad(Reason::Short, taken),
        Some(degc) if degc >= high => Temperature::bad(Reason::Open, taken),
        Some(degc) => Temperature::good(degc, taken),
    }
}
