//! Decodes a profile from its TOML file.

use volcomp_document::{FileKind, InputError, Section, Value};
use volcomp_port::Reason;

use super::{ByteOrder, Channels, Digital, Fault, NumberType, Profile, Status, Unit, WordOrder};
use crate::iec60751::RANGE_DEGC;

pub(super) fn profile(root: &Section<'_>) -> Result<Profile, InputError> {
    root.allow_in(FileKind::Profile, &["name", "baud", "channels", "digital", "unproven"])?;
    let name = root.require("name")?;
    if name.text()?.is_empty() {
        return Err(name.error("found an empty text, expected the name of the module"));
    }
    let unproven = root.optional("unproven", Value::texts)?.unwrap_or_default();
    let profile = Profile {
        name: name.text()?.to_owned(),
        baud: root.whole_or("baud", 1..=4_000_000, 9600)?,
        channels: root.section("channels")?.map(|s| channels(&s)).transpose()?,
        digital: root.section("digital")?.map(|s| digital(&s)).transpose()?,
        unproven: unproven.into_iter().map(str::to_owned).collect(),
    };
    if profile.channels.is_none() && profile.digital.is_none() {
        return Err(root.error("found neither, expected a table [channels] or [digital]"));
    }
    Ok(profile)
}

fn channels(section: &Section<'_>) -> Result<Channels, InputError> {
    section.allow(&[
        "function",
        "address",
        "count",
        "type",
        "word_order",
        "byte_order",
        "scale",
        "offset",
        "unit",
        "r0_ohm",
        "leads_ohm",
        "valid_degc",
        "faults",
        "status",
    ])?;
    let number = section.one_of(
        "type",
        &[
            ("i16", NumberType::I16),
            ("u16", NumberType::U16),
            ("i32", NumberType::I32),
            ("f32", NumberType::F32),
        ],
        NumberType::I16,
    )?;
    let scale = section.optional("scale", |value| match value.number()? {
        0.0 => Err(value.error("found 0, expected a number that is not 0")),
        scale => Ok(scale),
    })?;
    let counted = section.require("count")?;
    let count: u16 = counted.whole(1..=60)?;
    let address: u16 = section.require("address")?.whole(0..=65_535)?;
    if u32::from(address) + u32::from(count * number.registers()) > 65_536 {
        return Err(counted.error(format!(
            "found {count} channels from {address} on, expected registers below 65536"
        )));
    }
    let word_orders = [("high", WordOrder::HighFirst), ("low", WordOrder::LowFirst)];
    Ok(Channels {
        function: section.whole_or("function", 3..=4, 3)?,
        address,
        count,
        number,
        word_order: section.one_of("word_order", &word_orders, WordOrder::HighFirst)?,
        byte_order: section.one_of("byte_order", &ByteOrder::NAMES, ByteOrder::HighFirst)?,
        scale: scale.unwrap_or(1.0),
        offset: section.optional("offset", Value::number)?.unwrap_or(0.0),
        unit: unit(section)?,
        valid_degc: section.optional("valid_degc", valid_degc)?.unwrap_or(RANGE_DEGC),
        faults: section.tables("faults", fault)?,
        status: section.section("status")?.map(|s| status(&s)).transpose()?,
    })
}

fn unit(section: &Section<'_>) -> Result<Unit, InputError> {
    let ohm = Unit::Ohm {
        r0_ohm: section.optional("r0_ohm", Value::positive)?.unwrap_or(100.0),
        leads_ohm: section.optional("leads_ohm", Value::number)?.unwrap_or(0.0),
    };
    section.one_of("unit", &[("degc", Unit::Degc), ("ohm", ohm)], Unit::Degc)
}

fn valid_degc(value: &Value<'_>) -> Result<[f64; 2], InputError> {
    let [low, high] = value.vector()?;
    if low < high {
        return Ok([low, high]);
    }
    Err(value.error(format!("found {low} and {high}, expected the lower end below the upper end")))
}

fn fault(entry: &Section<'_>) -> Result<Fault, InputError> {
    entry.allow(&["raw", "reason"])?;
    let raw = entry.require("raw")?;
    let reasons = [
        ("open", Reason::Open),
        ("short", Reason::Short),
        ("reported", Reason::Reported),
        ("out-of-range", Reason::OutOfRange),
    ];
    Ok(Fault {
        raw: if raw.is_number() { [raw.number()?; 2] } else { raw.vector()? },
        reason: entry.require("reason")?.one_of(&reasons)?,
    })
}

fn status(section: &Section<'_>) -> Result<Status, InputError> {
    section.allow(&["function", "address", "mask"])?;
    Ok(Status {
        function: section.require("function")?.whole(1..=4)?,
        address: section.require("address")?.whole(0..=65_000)?,
        mask: section.whole_or("mask", 1..=65_535, 65_535)?,
    })
}

fn digital(section: &Section<'_>) -> Result<Digital, InputError> {
    section.allow(&["input_address", "inputs", "output_address", "outputs"])?;
    Ok(Digital {
        input_address: section.whole_or("input_address", 0..=65_000, 0)?,
        inputs: section.whole_or("inputs", 0..=64, 0)?,
        output_address: section.whole_or("output_address", 0..=65_000, 0)?,
        outputs: section.whole_or("outputs", 0..=64, 0)?,
    })
}
