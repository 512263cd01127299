//! The profile of a module: register addresses of its channels and the interpretation of their values.
//! Profiles are decoded from TOML.

use std::{path::Path, time::Instant};

use volcomp_document::{Document, FileKind, InputError, ReadError, Section, Value};
use volcomp_port::{Reason, Temperature};
use volcomp_vocabulary::bounds::is_plausible_reading;

use crate::iec60751::{self, RANGE_DEGC};

const SHIPPED: [&str; 14] = [
    include_str!("../profiles/pta8c04.toml"),
    include_str!("../profiles/pt21a01.toml"),
    include_str!("../profiles/seneca-z-4rtd.toml"),
    include_str!("../profiles/wago-750-461.toml"),
    include_str!("../profiles/wago-750-464.toml"),
    include_str!("../profiles/phoenix-rad-pt100-4-ifs.toml"),
    include_str!("../profiles/adam-4015.toml"),
    include_str!("../profiles/adam-6015.toml"),
    include_str!("../profiles/icp-das-m-7015.toml"),
    include_str!("../profiles/raw-ohm.toml"),
    include_str!("../profiles/custom.toml"),
    include_str!("../profiles/waveshare-io-8ch.toml"),
    include_str!("../profiles/wago-750-8di-8do.toml"),
    include_str!("../profiles/adam-6050.toml"),
];

#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProfileError {
    /// No shipped profile has this name.
    #[error("there is no profile `{name}`, expected one of: {known}; or a file that ends in .toml")]
    Unknown {
        /// The requested name.
        name: String,
        known: String,
    },
    /// The file of a profile cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The profile is not valid TOML, or one of its keys is missing, unknown or invalid.
    #[error(transparent)]
    Input(#[from] InputError),
}

/// Number format of a channel's registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum NumberType {
    /// One register, signed.
    I16,
    /// One register, unsigned.
    U16,
    /// Two registers, signed.
    I32,
    /// Two registers, a floating-point number.
    F32,
}

impl NumberType {
    /// Number of registers per value.
    pub fn registers(self) -> u16 {
        match self {
            Self::I16 | Self::U16 => 1,
            Self::I32 | Self::F32 => 2,
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum WordOrder {
    #[default]
    HighFirst,
    LowFirst,
}

/// Order of the bytes in each register of a value that has two registers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ByteOrder {
    /// The high byte comes first, as the Modbus standard specifies.
    #[default]
    HighFirst,
    LowFirst,
}

impl ByteOrder {
    /// Names of the byte orders in profiles and URLs.
    pub const NAMES: [(&'static str, Self); 2] =
        [("high", Self::HighFirst), ("low", Self::LowFirst)];
}

/// Quantity and unit of a number after scaling.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Unit {
    /// The number is a temperature in °C.
    Degc,
    /// The number is the resistance of a platinum sensor in Ω.
    Ohm {
        /// The resistance of the sensor at 0 °C, Ω.
        r0_ohm: f64,
        /// The resistance of both leads of a two-wire sensor together, Ω.
        leads_ohm: f64,
    },
}

/// A range of raw numbers that encodes a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Fault {
    /// Lowest and highest raw number that encode this fault.
    pub raw: [f64; 2],
    pub reason: Reason,
}

/// Registers with the fault bits of the channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Status {
    /// Modbus function that reads the fault bits: 1 coils, 2 discrete inputs, 3 holding registers, 4 input registers.
    pub function: u8,
    /// Address of the fault bits of the first channel, counted from 0.
    pub address: u16,
    /// Mask of the bits in a register that report a fault when set.
    pub mask: u16,
}

/// The temperature channels of a module, and how their registers are decoded.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Channels {
    /// Modbus function that reads the channels: 3 holding registers, 4 input registers.
    pub function: u8,
    /// Address of the first register, counted from 0.
    pub address: u16,
    pub count: u16,
    pub number: NumberType,
    pub word_order: WordOrder,
    /// Order of the bytes in each register of a value that has two registers.
    pub byte_order: ByteOrder,
    /// Factor of the raw number: value = raw number · `scale` + `offset`.
    pub scale: f64,
    /// Offset of the value, in `unit`.
    pub offset: f64,
    /// Quantity and unit of the value.
    pub unit: Unit,
    /// Lowest and highest temperature that the module can measure, °C.
    pub valid_degc: [f64; 2],
    pub faults: Vec<Fault>,
    /// Additional fault bits of the module; `None` if the module has none.
    pub status: Option<Status>,
}

/// Numbers and addresses of a module's digital lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Digital {
    /// Address of the first input (function 2), counted from 0.
    pub input_address: u16,
    pub inputs: u16,
    /// Address of the first output (functions 15 and 1), counted from 0.
    pub output_address: u16,
    pub outputs: u16,
}

/// A module's profile: its temperature channels, its digital lines, or both.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Profile {
    pub name: String,
    /// Default baud rate of the module on a serial line.
    pub baud: u32,
    /// The temperature channels; `None` if the module has none.
    pub channels: Option<Channels>,
    /// The digital lines; `None` if the module has none.
    pub digital: Option<Digital>,
    /// Parts of this profile that no source confirms.
    pub unproven: Vec<String>,
}

impl Profile {
    /// Returns the shipped profile with this name. Blanks, slashes and underscores count as `-`, and case does not
    /// matter.
    ///
    /// # Errors
    /// [`ProfileError::Unknown`] if there is no such profile.
    pub fn named(name: &str) -> Result<Self, ProfileError> {
        let plain = |name: &str| name.replace([' ', '/', '_'], "-").to_lowercase();
        let shipped = Self::shipped();
        let found = shipped.iter().find(|p| plain(&p.name) == plain(name));
        found.cloned().ok_or_else(|| ProfileError::Unknown {
            name: name.to_owned(),
            known: shipped.iter().map(|p| &*p.name).collect::<Vec<_>>().join(", "),
        })
    }

    pub fn shipped() -> Vec<Self> {
        // Parsing never fails, because the tests parse each shipped profile.
        SHIPPED.iter().filter_map(|text| Self::parse(text).ok()).collect()
    }

    /// Reads a profile from a file.
    ///
    /// # Errors
    /// The file cannot be read, is not TOML, or has a missing, unknown or invalid key.
    pub fn read(file: &Path) -> Result<Self, ProfileError> {
        Document::read(file)?.decode(|root| Ok(profile(&root)?))
    }

    /// Parses a profile from TOML.
    ///
    /// # Errors
    /// Text that is not TOML, or a missing, unknown or invalid key.
    pub fn parse(text: &str) -> Result<Self, ProfileError> {
        Document::new("profile", text).decode(|root| Ok(profile(&root)?))
    }
}

fn profile(root: &Section<'_>) -> Result<Profile, InputError> {
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
    let encodes = |fault: &&Fault| {
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
