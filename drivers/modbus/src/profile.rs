//! What is known of a module, as data: where its channels stand and what their numbers mean.

use std::collections::BTreeMap;

use toml::{Table, Value};
use volcomp_port::Reason;

/// Profiles that ship with the crate.
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

/// A profile that is not there or makes no sense.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ProfileError {
    /// No profile of this name.
    #[error("there is no profile `{name}`, expected one of: {known}")]
    Unknown {
        /// The name asked for.
        name: String,
        /// Those that there are.
        known: String,
    },
    /// No TOML.
    #[error("profile: {0}")]
    Syntax(String),
    /// A key that is missing, unknown or wrong.
    #[error("profile `{profile}`, key `{key}`: {found}, expected {expected}")]
    Key {
        /// The profile.
        profile: String,
        /// The key.
        key: String,
        /// What was found.
        found: String,
        /// What was expected.
        expected: String,
    },
}

/// How a channel's registers make a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NumberType {
    /// One register, signed.
    I16,
    /// One register.
    U16,
    /// Two registers, signed.
    I32,
    /// Two registers, floating point.
    F32,
}

impl NumberType {
    /// Registers of one number.
    pub fn registers(self) -> u16 {
        match self {
            Self::I16 | Self::U16 => 1,
            Self::I32 | Self::F32 => 2,
        }
    }
}

/// Which of two registers comes first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WordOrder {
    /// The high word.
    #[default]
    HighFirst,
    /// The low word.
    LowFirst,
}

/// What a scaled number is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unit {
    /// °C.
    Degc,
    /// Ω of a sensor with so many at 0 °C.
    Ohm {
        /// R₀.
        r0_ohm: f64,
        /// Both leads of a two-wire sensor.
        leads_ohm: f64,
    },
}

/// A raw number that stands for a fault.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// The raw numbers, both included.
    pub raw: [f64; 2],
    /// Which fault.
    pub reason: Reason,
}

/// Bits that tell of a channel's faults.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Function to read them: 1 coils, 2 inputs, 3 holding registers, 4 input registers.
    pub function: u8,
    /// Place of the first channel's.
    pub address: u16,
    /// What is a fault when it is not 0, of a register.
    pub mask: u16,
}

/// Temperature channels of a module.
#[derive(Clone, Debug, PartialEq)]
pub struct Channels {
    /// 3: holding registers, 4: input registers.
    pub function: u8,
    /// First register, counted from 0.
    pub address: u16,
    /// How many channels.
    pub count: u16,
    /// Type of the numbers.
    pub number: NumberType,
    /// Order of two registers.
    pub word_order: WordOrder,
    /// Times the raw number …
    pub scale: f64,
    /// … plus this is the value in its unit.
    pub offset: f64,
    /// The unit.
    pub unit: Unit,
    /// What the module can measure, °C.
    pub valid_degc: [f64; 2],
    /// Raw numbers that stand for faults.
    pub faults: Vec<Fault>,
    /// Where faults are told besides.
    pub status: Option<Status>,
}

/// Digital lines of a module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Digital {
    /// First input (function 2), counted from 0.
    pub input_address: u16,
    /// How many.
    pub inputs: u16,
    /// First output (functions 15 and 1).
    pub output_address: u16,
    /// How many.
    pub outputs: u16,
}

/// A module.
#[derive(Clone, Debug, PartialEq)]
pub struct Profile {
    /// Its name.
    pub name: String,
    /// Speed as delivered, Bd.
    pub baud: u32,
    /// Its temperatures.
    pub channels: Option<Channels>,
    /// Its lines.
    pub digital: Option<Digital>,
    /// What of this is not proven by a source that was read.
    pub unproven: Vec<String>,
}

impl Profile {
    /// A shipped profile: blanks and slashes of the name as `-`, case ignored.
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

    /// Every shipped profile.
    pub fn shipped() -> Vec<Self> {
        // Tests read every one of them.
        SHIPPED
            .iter()
            .filter_map(|text| Self::parse(text).ok())
            .collect()
    }

    /// Reads a profile.
    ///
    /// # Errors
    /// No TOML, a key that is missing, unknown or wrong.
    pub fn parse(text: &str) -> Result<Self, ProfileError> {
        let table: Table = text
            .parse()
            .map_err(|e: toml::de::Error| ProfileError::Syntax(e.message().to_owned()))?;
        let root = Section {
            profile: table
                .get("name")
                .and_then(Value::as_str)
                .unwrap_or("?")
                .to_owned(),
            path: String::new(),
            table: &table,
        };
        root.allow(&["name", "baud", "channels", "digital", "unproven"])?;
        let unproven = match table.get("unproven") {
            None => Vec::new(),
            Some(value) => {
                let texts = value
                    .as_array()
                    .map(|list| list.iter().map(Value::as_str).collect());
                let texts: Option<Vec<&str>> =
                    texts.and_then(|texts: Vec<_>| texts.into_iter().collect());
                let texts = texts.ok_or_else(|| root.wrong("unproven", "a list of texts"))?;
                texts.into_iter().map(str::to_owned).collect()
            }
        };
        let profile = Self {
            name: root.text("name")?.to_owned(),
            baud: root.whole("baud", 1..=4_000_000, Some(9600))?,
            channels: root
                .section("channels")?
                .map(|s| channels(&s))
                .transpose()?,
            digital: root.section("digital")?.map(|s| digital(&s)).transpose()?,
            unproven,
        };
        if profile.channels.is_none() && profile.digital.is_none() {
            return Err(root.wrong("channels", "a table [channels] or [digital]"));
        }
        Ok(profile)
    }
}

fn channels(section: &Section<'_>) -> Result<Channels, ProfileError> {
    section.allow(&[
        "function",
        "address",
        "count",
        "type",
        "word_order",
        "scale",
        "offset",
        "unit",
        "r0_ohm",
        "leads_ohm",
        "valid_degc",
        "faults",
        "status",
    ])?;
    let unit = match section.word("unit", &["degc", "ohm"], Some("degc"))? {
        "ohm" => Unit::Ohm {
            r0_ohm: section.number("r0_ohm", Some(100.0))?,
            leads_ohm: section.number("leads_ohm", Some(0.0))?,
        },
        _ => Unit::Degc,
    };
    if let Unit::Ohm { r0_ohm, .. } = unit
        && r0_ohm <= 0.0
    {
        return Err(section.wrong("r0_ohm", "a positive resistance"));
    }
    let scale = section.number("scale", Some(1.0))?;
    if scale == 0.0 {
        return Err(section.wrong("scale", "a number that is not 0"));
    }
    let [low, high] = section.pair("valid_degc", [-200.0, 850.0])?;
    if low >= high {
        return Err(section.wrong("valid_degc", "the lower end below the upper end"));
    }
    let number = match section.word("type", &["i16", "u16", "i32", "f32"], Some("i16"))? {
        "u16" => NumberType::U16,
        "i32" => NumberType::I32,
        "f32" => NumberType::F32,
        _ => NumberType::I16,
    };
    let count: u16 = section.whole("count", 1..=60, None)?;
    let address: u16 = section.whole("address", 0..=65_535, None)?;
    if u32::from(address) + u32::from(count * number.registers()) > 65_536 {
        return Err(section.wrong("count", "registers below 65536"));
    }
    Ok(Channels {
        function: section.whole("function", 3..=4, Some(3))?,
        address,
        count,
        number,
        word_order: match section.word("word_order", &["high", "low"], Some("high"))? {
            "low" => WordOrder::LowFirst,
            _ => WordOrder::HighFirst,
        },
        scale,
        offset: section.number("offset", Some(0.0))?,
        unit,
        valid_degc: [low, high],
        faults: faults(section)?,
        status: section.section("status")?.map(|s| status(&s)).transpose()?,
    })
}

const REASONS: [(&str, Reason); 4] = [
    ("open", Reason::Open),
    ("short", Reason::Short),
    ("reported", Reason::Reported),
    ("out-of-range", Reason::OutOfRange),
];

fn faults(section: &Section<'_>) -> Result<Vec<Fault>, ProfileError> {
    let Some(value) = section.table.get("faults") else {
        return Ok(Vec::new());
    };
    let expected = "tables { raw = NUMBER or [FROM, TO], reason = WORD }";
    let list = value
        .as_array()
        .ok_or_else(|| section.wrong("faults", expected))?;
    let fault = |(place, value): (usize, &Value)| {
        let table = value
            .as_table()
            .ok_or_else(|| section.wrong("faults", expected))?;
        let entry = Section {
            profile: section.profile.clone(),
            path: format!("{}faults.{place}.", section.path),
            table,
        };
        entry.allow(&["raw", "reason"])?;
        let raw = match table.get("raw") {
            Some(Value::Array(_)) => entry.pair("raw", [0.0; 2])?,
            _ => [entry.number("raw", None)?; 2],
        };
        let words = REASONS.map(|(word, _)| word);
        let word = entry.word("reason", &words, None)?;
        let reason = REASONS.iter().find(|(known, _)| *known == word);
        Ok(Fault {
            raw,
            reason: reason.map_or(Reason::Reported, |(_, reason)| *reason),
        })
    };
    list.iter().enumerate().map(fault).collect()
}

fn status(section: &Section<'_>) -> Result<Status, ProfileError> {
    section.allow(&["function", "address", "mask"])?;
    Ok(Status {
        function: section.whole("function", 1..=4, None)?,
        address: section.whole("address", 0..=65_000, None)?,
        mask: section.whole("mask", 1..=65_535, Some(65_535))?,
    })
}

fn digital(section: &Section<'_>) -> Result<Digital, ProfileError> {
    section.allow(&["input_address", "inputs", "output_address", "outputs"])?;
    Ok(Digital {
        input_address: section.whole("input_address", 0..=65_000, Some(0))?,
        inputs: section.whole("inputs", 0..=64, Some(0))?,
        output_address: section.whole("output_address", 0..=65_000, Some(0))?,
        outputs: section.whole("outputs", 0..=64, Some(0))?,
    })
}

struct Section<'a> {
    profile: String,
    path: String,
    table: &'a Table,
}

impl Section<'_> {
    fn wrong(&self, key: &str, expected: &str) -> ProfileError {
        let found = match self.table.get(key) {
            Some(value) => format!("found {value}"),
            None => "it is missing".to_owned(),
        };
        ProfileError::Key {
            profile: self.profile.clone(),
            key: format!("{}{key}", self.path),
            found,
            expected: expected.to_owned(),
        }
    }

    fn allow(&self, known: &[&str]) -> Result<(), ProfileError> {
        match self.table.keys().find(|key| !known.contains(&key.as_str())) {
            Some(key) => Err(self.wrong(key, &format!("one of: {}", known.join(", ")))),
            None => Ok(()),
        }
    }

    fn section(&self, key: &str) -> Result<Option<Section<'_>>, ProfileError> {
        let Some(value) = self.table.get(key) else {
            return Ok(None);
        };
        let table = value.as_table().ok_or_else(|| self.wrong(key, "a table"))?;
        Ok(Some(Section {
            profile: self.profile.clone(),
            path: format!("{}{key}.", self.path),
            table,
        }))
    }

    fn text(&self, key: &str) -> Result<&str, ProfileError> {
        let text = self.table.get(key).and_then(Value::as_str);
        text.filter(|text| !text.is_empty())
            .ok_or_else(|| self.wrong(key, "a text"))
    }

    fn number(&self, key: &str, default: Option<f64>) -> Result<f64, ProfileError> {
        let number = match (self.table.get(key), default) {
            (None, Some(default)) => return Ok(default),
            (Some(Value::Float(number)), _) => Some(*number),
            #[expect(clippy::cast_precision_loss, reason = "settings are small numbers")]
            (Some(Value::Integer(number)), _) => Some(*number as f64),
            _ => None,
        };
        let finite = number.filter(|number| number.is_finite());
        finite.ok_or_else(|| self.wrong(key, "a finite number"))
    }

    fn pair(&self, key: &str, default: [f64; 2]) -> Result<[f64; 2], ProfileError> {
        let Some(value) = self.table.get(key) else {
            return Ok(default);
        };
        let numbers: BTreeMap<&str, Value> = match value.as_array().map(Vec::as_slice) {
            Some([low, high]) => [("low", low.clone()), ("high", high.clone())].into(),
            _ => return Err(self.wrong(key, "two numbers")),
        };
        let both = Section {
            profile: self.profile.clone(),
            path: format!("{}{key}.", self.path),
            table: &numbers
                .into_iter()
                .map(|(k, v)| (k.to_owned(), v))
                .collect(),
        };
        Ok([both.number("low", None)?, both.number("high", None)?])
    }

    fn word<'w>(
        &self,
        key: &str,
        words: &[&'w str],
        default: Option<&'w str>,
    ) -> Result<&'w str, ProfileError> {
        if let (None, Some(default)) = (self.table.get(key), default) {
            return Ok(default);
        }
        let found = self.table.get(key).and_then(Value::as_str);
        let known = words.iter().find(|word| Some(**word) == found);
        known
            .copied()
            .ok_or_else(|| self.wrong(key, &format!("one of: {}", words.join(", "))))
    }

    fn whole<N: TryFrom<i64>>(
        &self,
        key: &str,
        range: std::ops::RangeInclusive<i64>,
        default: Option<i64>,
    ) -> Result<N, ProfileError> {
        let found = match self.table.get(key) {
            None => default,
            Some(value) => value.as_integer(),
        };
        let within = found.filter(|found| range.contains(found));
        within
            .and_then(|found| N::try_from(found).ok())
            .ok_or_else(|| {
                let expected = format!("a whole number from {} to {}", range.start(), range.end());
                self.wrong(key, &expected)
            })
    }
}
