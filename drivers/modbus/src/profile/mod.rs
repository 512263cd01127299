//! The profile of a module: register addresses of its channels and the interpretation of their values.

mod decode;

use std::path::Path;

use volcomp_document::{Document, InputError, ReadError};
use volcomp_port::Reason;

const SHIPPED: [&str; 14] = [
    include_str!("../../profiles/pta8c04.toml"),
    include_str!("../../profiles/pt21a01.toml"),
    include_str!("../../profiles/seneca-z-4rtd.toml"),
    include_str!("../../profiles/wago-750-461.toml"),
    include_str!("../../profiles/wago-750-464.toml"),
    include_str!("../../profiles/phoenix-rad-pt100-4-ifs.toml"),
    include_str!("../../profiles/adam-4015.toml"),
    include_str!("../../profiles/adam-6015.toml"),
    include_str!("../../profiles/icp-das-m-7015.toml"),
    include_str!("../../profiles/raw-ohm.toml"),
    include_str!("../../profiles/custom.toml"),
    include_str!("../../profiles/waveshare-io-8ch.toml"),
    include_str!("../../profiles/wago-750-8di-8do.toml"),
    include_str!("../../profiles/adam-6050.toml"),
];

/// Errors of a profile: it does not exist, or is invalid.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProfileError {
    /// No shipped profile has this name.
    #[error("there is no profile `{name}`, expected one of: {known}; or a file that ends in .toml")]
    Unknown {
        /// The requested name.
        name: String,
        /// The names of the shipped profiles.
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

/// Order of the two registers that hold one value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum WordOrder {
    /// The high word comes first.
    #[default]
    HighFirst,
    /// The low word comes first.
    LowFirst,
}

/// Order of the bytes in each register of a two-register value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ByteOrder {
    /// The high byte comes first, as in the Modbus standard.
    #[default]
    HighFirst,
    /// The low byte comes first.
    LowFirst,
}

impl ByteOrder {
    /// The names of both orders in profiles and URLs.
    pub const NAMES: [(&'static str, Self); 2] =
        [("high", Self::HighFirst), ("low", Self::LowFirst)];
}

/// Quantity and unit of a scaled number.
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
    /// The lowest and highest raw number that report this fault.
    pub raw: [f64; 2],
    /// The fault that these numbers encode.
    pub reason: Reason,
}

/// Fault bits of the channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Status {
    /// The Modbus function that reads the fault bits: 1 coils, 2 inputs, 3 holding registers, 4 input registers.
    pub function: u8,
    /// The address of the first channel's bits, counted from 0.
    pub address: u16,
    /// Mask of the bits of a register that report a fault when set.
    pub mask: u16,
}

/// The temperature channels of a module, and how their registers are decoded.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Channels {
    /// The Modbus function that reads the channels: 3 holding registers, 4 input registers.
    pub function: u8,
    /// The address of the first register, counted from 0.
    pub address: u16,
    /// The number of channels.
    pub count: u16,
    /// Number format of a channel's registers.
    pub number: NumberType,
    /// Order of the two registers of a value.
    pub word_order: WordOrder,
    /// Order of the bytes in each register of a two-register value.
    pub byte_order: ByteOrder,
    /// Factor of the raw number: value = raw number · `scale` + `offset`.
    pub scale: f64,
    /// Offset, in `unit`.
    pub offset: f64,
    /// The quantity and unit of the value.
    pub unit: Unit,
    /// The lowest and the highest temperature that the module can measure, °C.
    pub valid_degc: [f64; 2],
    /// Raw numbers that encode faults.
    pub faults: Vec<Fault>,
    /// Additional fault bits of the module; `None`: it has none.
    pub status: Option<Status>,
}

/// Numbers and addresses of a module's digital lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Digital {
    /// The address of the first input (function 2), counted from 0.
    pub input_address: u16,
    /// The number of inputs.
    pub inputs: u16,
    /// The address of the first output (functions 15 and 1), counted from 0.
    pub output_address: u16,
    /// The number of outputs.
    pub outputs: u16,
}

/// A module's profile: its temperature channels, its digital lines, or both.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Profile {
    /// The name of the module.
    pub name: String,
    /// Baud rate of the serial line as delivered.
    pub baud: u32,
    /// The temperature channels; `None`: the module has none.
    pub channels: Option<Channels>,
    /// The digital lines; `None`: the module has none.
    pub digital: Option<Digital>,
    /// Parts of this profile that no source confirms.
    pub unproven: Vec<String>,
}

impl Profile {
    /// Returns a shipped profile by its name. Blanks, slashes and underscores are treated as `-`; case does not matter.
    ///
    /// # Errors
    /// [`ProfileError::Unknown`].
    pub fn named(name: &str) -> Result<Self, ProfileError> {
        let plain = |name: &str| name.replace([' ', '/', '_'], "-").to_lowercase();
        let shipped = Self::shipped();
        let found = shipped.iter().find(|p| plain(&p.name) == plain(name));
        found.cloned().ok_or_else(|| ProfileError::Unknown {
            name: name.to_owned(),
            known: shipped.iter().map(|p| &*p.name).collect::<Vec<_>>().join(", "),
        })
    }

    /// All profiles shipped with the crate.
    pub fn shipped() -> Vec<Self> {
        // Infallible: the tests parse each of them.
        SHIPPED.iter().filter_map(|text| Self::parse(text).ok()).collect()
    }

    /// Reads a profile from a file.
    ///
    /// # Errors
    /// The file cannot be read, is not TOML, or has a missing, unknown or invalid key.
    pub fn read(file: &Path) -> Result<Self, ProfileError> {
        Document::read(file)?.decode(|root| Ok(decode::profile(&root)?))
    }

    /// Parses a profile from TOML.
    ///
    /// # Errors
    /// Not TOML, or a missing, unknown or invalid key.
    pub fn parse(text: &str) -> Result<Self, ProfileError> {
        Document::new("profile", text).decode(|root| Ok(decode::profile(&root)?))
    }
}
