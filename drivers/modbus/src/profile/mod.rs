//! The profile of a module, as data: at which registers its channels stand and what their numbers mean.

mod decode;

use std::path::Path;

use volcomp_document::{Document, InputError, ReadError};
use volcomp_port::Reason;

/// Profiles that ship with the crate.
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

/// A profile that is not there or makes no sense.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ProfileError {
    /// No shipped profile has this name.
    #[error("there is no profile `{name}`, expected one of: {known}; or a file that ends in .toml")]
    Unknown {
        /// The name asked for.
        name: String,
        /// The names that there are.
        known: String,
    },
    /// The file of a profile cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The text of a profile is no TOML, or a key of it is missing, unknown or wrong.
    #[error(transparent)]
    Input(#[from] InputError),
}

/// How a channel's registers make a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum NumberType {
    /// One register, a signed number.
    I16,
    /// One register, a number without sign.
    U16,
    /// Two registers, a signed number.
    I32,
    /// Two registers, a floating-point number.
    F32,
}

impl NumberType {
    /// How many registers one number takes.
    pub fn registers(self) -> u16 {
        match self {
            Self::I16 | Self::U16 => 1,
            Self::I32 | Self::F32 => 2,
        }
    }
}

/// Which of two registers comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum WordOrder {
    /// The high word comes first.
    #[default]
    HighFirst,
    /// The low word comes first.
    LowFirst,
}

/// Which byte of a register comes first, where two registers make one number.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ByteOrder {
    /// The high byte comes first, as the standard has it.
    #[default]
    HighFirst,
    /// The low byte comes first.
    LowFirst,
}

impl ByteOrder {
    /// The names of both in profiles and URLs.
    pub const NAMES: [(&'static str, Self); 2] =
        [("high", Self::HighFirst), ("low", Self::LowFirst)];
}

/// The quantity and unit of a scaled number.
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

/// A raw number that stands for a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Fault {
    /// The lowest and the highest of the raw numbers that tell this fault.
    pub raw: [f64; 2],
    /// The fault that they stand for.
    pub reason: Reason,
}

/// Bits that tell of a channel's faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Status {
    /// The Modbus function that reads them: 1 coils, 2 inputs, 3 holding registers, 4 input registers.
    pub function: u8,
    /// The address of the first channel's bits, counted from 0.
    pub address: u16,
    /// The bits of a register that tell a fault where they are not 0.
    pub mask: u16,
}

/// Temperature channels of a module.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Channels {
    /// The Modbus function that reads them: 3 holding registers, 4 input registers.
    pub function: u8,
    /// The address of the first register, counted from 0.
    pub address: u16,
    /// The number of channels.
    pub count: u16,
    /// How registers make a number.
    pub number: NumberType,
    /// Which of two registers comes first.
    pub word_order: WordOrder,
    /// Which byte of each of two registers comes first.
    pub byte_order: ByteOrder,
    /// The value is the raw number times this …
    pub scale: f64,
    /// … plus this, in the unit.
    pub offset: f64,
    /// The quantity and unit of the value.
    pub unit: Unit,
    /// The lowest and the highest temperature that the module can measure, °C.
    pub valid_degc: [f64; 2],
    /// The raw numbers that stand for faults.
    pub faults: Vec<Fault>,
    /// Where the module tells faults besides; `None`: nowhere.
    pub status: Option<Status>,
}

/// Digital lines of a module.
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

/// A module: its temperature channels, its digital lines, or both.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Profile {
    /// The name of the module.
    pub name: String,
    /// The speed of the serial line as delivered, Bd.
    pub baud: u32,
    /// The temperature channels; `None`: the module has none.
    pub channels: Option<Channels>,
    /// The digital lines; `None`: the module has none.
    pub digital: Option<Digital>,
    /// The parts of this profile that no source has confirmed.
    pub unproven: Vec<String>,
}

impl Profile {
    /// A shipped profile: blanks, slashes and underscores of the name count as `-`, upper and lower case alike.
    ///
    /// # Errors
    /// [`ProfileError::Unknown`].
    pub fn named(name: &str) -> Result<Self, ProfileError> {
        let plain = |name: &str| name.replace([' ', '/', '_'], "-").to_lowercase();
        let shipped = Self::shipped();
        let found = shipped.iter().find(|p| plain(&p.name) == plain(name));
        found.cloned().ok_or_else(|| ProfileError::Unknown {
            name: name.to_owned(),
            known: shipped
                .iter()
                .map(|p| &*p.name)
                .collect::<Vec<_>>()
                .join(", "),
        })
    }

    /// All profiles that are shipped with the crate.
    pub fn shipped() -> Vec<Self> {
        // Tests read every one of them.
        SHIPPED
            .iter()
            .filter_map(|text| Self::parse(text).ok())
            .collect()
    }

    /// Reads a profile from a file.
    ///
    /// # Errors
    /// The file cannot be read, is no TOML, or a key of it is missing, unknown or wrong.
    pub fn read(file: &Path) -> Result<Self, ProfileError> {
        Document::read(file)?.decode(|root| Ok(decode::profile(&root)?))
    }

    /// Takes the text of a profile.
    ///
    /// # Errors
    /// No TOML, or a key that is missing, unknown or wrong.
    pub fn parse(text: &str) -> Result<Self, ProfileError> {
        Document::new("profile", text).decode(|root| Ok(decode::profile(&root)?))
    }
}
