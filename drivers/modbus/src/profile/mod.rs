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
        Document::read(file)?.decode(|root| Ok(decode::profile(&root)?))
    }

    /// Parses a profile from TOML.
    ///
    /// # Errors
    /// Text that is not TOML, or a missing, unknown or invalid key.
    pub fn parse(text: &str) -> Result<Self, ProfileError> {
        Document::new("profile", text).decode(|root| Ok(decode::profile(&root)?))
    }
}
