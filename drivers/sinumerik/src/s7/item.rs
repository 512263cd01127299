//! What is read or written: a part of a data block, or a variable of the NCK.

use super::error::S7Error;

/// The most items of one request.
pub const MOST_ITEMS: usize = 20;
/// The longest part of a data block in one item, bytes: what fits into the smallest PDU.
pub const LONGEST_BLOCK: u16 = 200;

/// The area of a variable of the NCK.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Area {
    /// The NCK as a whole.
    Nck,
    /// A mode group.
    ModeGroup,
    /// A channel.
    Channel,
    /// An axis.
    Axis,
    /// A tool area.
    Tool,
    /// A feed drive.
    FeedDrive,
    /// A main spindle drive.
    MainDrive,
    /// The operator's panel.
    Panel,
}

impl Area {
    const ALL: [Self; 8] = [
        Self::Nck,
        Self::ModeGroup,
        Self::Channel,
        Self::Axis,
        Self::Tool,
        Self::FeedDrive,
        Self::MainDrive,
        Self::Panel,
    ];

    fn code(self) -> u8 {
        match self {
            Self::Nck => 0,
            Self::ModeGroup => 1,
            Self::Channel => 2,
            Self::Axis => 3,
            Self::Tool => 4,
            Self::FeedDrive => 5,
            Self::MainDrive => 6,
            Self::Panel => 7,
        }
    }
}

/// The address of a variable of the NCK.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NckVariable {
    /// The area.
    pub area: Area,
    /// The number within the area, such as that of the channel, 0 to 31.
    pub unit: u8,
    /// The column of the table: which variable.
    pub column: u16,
    /// The first line of the table: which element.
    pub line: u16,
    /// The module: which table.
    pub module: u8,
    /// How many lines.
    pub lines: u8,
}

impl NckVariable {
    /// R parameter of a channel (from 1): eight bytes, a floating-point number.
    ///
    /// The published example is channel 1 with column 1 and line 1; that the line is the number of the parameter plus one is
    /// not proven.
    pub fn r_parameter(channel: u8, line: u16) -> Self {
        Self {
            area: Area::Channel,
            unit: channel,
            column: 1,
            line,
            module: 0x15,
            lines: 1,
        }
    }
}

/// One item of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Item {
    /// Bytes of a data block of the PLC.
    Block {
        /// The number of the data block.
        number: u16,
        /// The first byte.
        first: u16,
        /// How many bytes, up to [`LONGEST_BLOCK`].
        count: u16,
    },
    /// A variable of the NCK.
    Nck(NckVariable),
}

const SPECIFICATION: u8 = 0x12;
const ANY: u8 = 0x10;
const NCK: u8 = 0x82;
const BYTES: u8 = 0x02;
const DATA_BLOCK: u8 = 0x84;

impl Item {
    /// Checks that it can be written down.
    pub(crate) fn check(self) -> Result<(), S7Error> {
        let wrong = |found: String, expected: &str| {
            Err(S7Error::Request {
                found,
                expected: expected.to_owned(),
            })
        };
        match self {
            Self::Block { count, .. } if !(1..=LONGEST_BLOCK).contains(&count) => wrong(
                format!("found {count} bytes of a data block"),
                "1 to 200 in one item",
            ),
            Self::Nck(variable) if variable.unit > 31 => {
                wrong(format!("found the unit {}", variable.unit), "0 to 31")
            }
            Self::Nck(variable) if variable.lines == 0 => {
                wrong("found no line of a variable".to_owned(), "1 to 255")
            }
            _ => Ok(()),
        }
    }

    /// Appends it as it stands in a request.
    pub(crate) fn put(self, into: &mut Vec<u8>) {
        match self {
            Self::Block {
                number,
                first,
                count,
            } => {
                into.extend([SPECIFICATION, 10, ANY, BYTES]);
                into.extend(count.to_be_bytes());
                into.extend(number.to_be_bytes());
                into.push(DATA_BLOCK);
                // The address in bits, 24 of them.
                into.extend(&(u32::from(first) * 8).to_be_bytes()[1..]);
            }
            Self::Nck(variable) => {
                into.extend([SPECIFICATION, 8, NCK]);
                into.push(variable.area.code() << 5 | variable.unit & 31);
                into.extend(variable.column.to_be_bytes());
                into.extend(variable.line.to_be_bytes());
                into.extend([variable.module, variable.lines]);
            }
        }
    }

    /// Takes one from the front of a request; what is left after it.
    pub(crate) fn take(bytes: &[u8]) -> Result<(Self, &[u8]), S7Error> {
        let (&[specification, length, syntax], rest) =
            bytes.split_first_chunk().ok_or(S7Error::Short("an item"))?;
        if specification != SPECIFICATION {
            return Err(S7Error::Frame("an item of another kind"));
        }
        match (syntax, length) {
            (ANY, 10) => {
                let (&[kind, c1, c0, n1, n0, area, b2, b1, b0], rest) =
                    rest.split_first_chunk().ok_or(S7Error::Short("an item"))?;
                let bits = u32::from_be_bytes([0, b2, b1, b0]);
                if kind != BYTES || area != DATA_BLOCK || !bits.is_multiple_of(8) {
                    return Err(S7Error::Frame("an item that is no bytes of a data block"));
                }
                let first = u16::try_from(bits / 8)
                    .map_err(|_| S7Error::Frame("an item beyond a data block"))?;
                let item = Self::Block {
                    number: u16::from_be_bytes([n1, n0]),
                    first,
                    count: u16::from_be_bytes([c1, c0]),
                };
                Ok((item, rest))
            }
            (NCK, 8) => {
                let (&[of, c1, c0, l1, l0, module, lines], rest) =
                    rest.split_first_chunk().ok_or(S7Error::Short("an item"))?;
                let item = Self::Nck(NckVariable {
                    area: Area::ALL[usize::from(of >> 5)],
                    unit: of & 31,
                    column: u16::from_be_bytes([c1, c0]),
                    line: u16::from_be_bytes([l1, l0]),
                    module,
                    lines,
                });
                Ok((item, rest))
            }
            _ => Err(S7Error::Frame("an item of another syntax")),
        }
    }
}
