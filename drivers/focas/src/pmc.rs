//! Places in the memory of the PMC, the programmable machine controller, and shifts as whole numbers of counts there.

use std::fmt;

/// An area of the memory of the PMC, the programmable machine controller.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum PmcArea {
    /// Signals from the PMC to the control.
    G = 0,
    /// Signals from the control to the PMC.
    F = 1,
    /// Outputs of the PMC to the machine.
    Y = 2,
    /// Inputs of the PMC from the machine.
    X = 3,
    /// Requests for messages to the operator.
    A = 4,
    /// Internal relays of the ladder.
    R = 5,
    /// Timers of the ladder.
    T = 6,
    /// Keep relays, which outlast a power cut.
    K = 7,
    /// Counters of the ladder.
    C = 8,
    /// Data tables of the ladder.
    D = 9,
}

impl PmcArea {
    /// All areas, in the order of their codes.
    pub const ALL: [Self; 10] = [
        Self::G,
        Self::F,
        Self::Y,
        Self::X,
        Self::A,
        Self::R,
        Self::T,
        Self::K,
        Self::C,
        Self::D,
    ];

    /// Whether the area is memory of the ladder's own, which has no meaning to the control or the machine until the ladder
    /// gives it one. Only there a program outside may write, and a barrier report.
    pub fn is_of_ladder(self) -> bool {
        matches!(self, Self::R | Self::D)
    }

    /// What an area holds that is not the ladder's own memory.
    pub(crate) fn holds(self) -> &'static str {
        match self {
            Self::G => {
                "G holds the signals to the control, its emergency stop among them, which the ladder alone sets"
            }
            Self::F => "F holds the signals of the control, which nobody else writes",
            Self::Y => "Y holds the outputs to the machine",
            Self::X => "X holds the inputs from the machine",
            Self::A => "A holds the messages to the operator",
            Self::T => "T holds the times of the ladder's timers",
            Self::K => "K holds the settings of the ladder",
            Self::C => "C holds the counters of the ladder",
            Self::R | Self::D => "it is memory of the ladder's own",
        }
    }

    /// The area of a letter; `None` where there is none.
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|area| format!("{area:?}").starts_with(letter.to_ascii_uppercase()))
    }
}

/// The number of bytes of one point of PMC memory.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Width {
    /// One byte, a signed number.
    Byte,
    /// Two bytes, a signed number.
    #[default]
    Word,
    /// Four bytes, a signed number.
    Long,
}

impl Width {
    pub fn bytes(self) -> u16 {
        match self {
            Self::Byte => 1,
            Self::Word => 2,
            Self::Long => 4,
        }
    }

    /// The largest number, in either direction, that a point can hold.
    pub fn largest(self) -> i32 {
        match self {
            Self::Byte => i32::from(i8::MAX),
            Self::Word => i32::from(i16::MAX),
            Self::Long => i32::MAX,
        }
    }

    pub(crate) fn code(self) -> i32 {
        match self {
            Self::Byte => 0,
            Self::Word => 1,
            Self::Long => 2,
        }
    }
}

/// A place in the memory of the PMC.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PmcAddress {
    pub area: PmcArea,
    /// The number of the byte in the area.
    pub at: u16,
}

impl fmt::Display for PmcAddress {
    /// As ladders name it: `R100`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}{}", self.area, self.at)
    }
}

/// Where frames and reports of a barrier lie in the memory of the PMC. Both are words of two bytes, one after the other,
/// the low byte first, as the PMC keeps numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BarrierArea {
    /// The first byte of the frame, which the driver writes and the ladder reads.
    pub frame: PmcAddress,
    /// The first byte of the report, which the ladder writes and the driver reads.
    pub report: PmcAddress,
}

impl BarrierArea {
    /// The number of words of a frame for so many axes: epoch, tick, sequence, owner, a value for each axis, two of a checksum.
    pub const fn frame_words(axes: usize) -> usize {
        4 + axes + 2
    }

    /// The number of words of a report for so many axes: a head of eight, three for each axis, two of a checksum.
    pub const fn report_words(axes: usize) -> usize {
        8 + 3 * axes + 2
    }
}

/// Bytes of the PMC's memory that belong together, and what they are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// The key of a configuration that says where they are: `area.first`, `heartbeat`, `sequence`, `referenced`,
    /// `barrier.frame` or `barrier.report`. Empty where the control says it.
    pub key: &'static str,
    /// What the bytes are for, in words.
    pub what: &'static str,
    pub first: PmcAddress,
    pub last: PmcAddress,
}

impl Block {
    /// The first byte that both have; `None` where they lie apart.
    pub fn shared(&self, other: &Self) -> Option<PmcAddress> {
        let at = self.first.at.max(other.first.at);
        let is_in_both =
            self.first.area == other.first.area && at <= self.last.at && at <= other.last.at;
        is_in_both.then_some(PmcAddress { at, ..self.first })
    }
}

impl fmt::Display for Block {
    /// What it is and where it lies: `the words of the shifts R100 to R105`, `the heartbeat R120`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.what, self.first)?;
        if self.last != self.first {
            write!(f, " to {}", self.last)?;
        }
        Ok(())
    }
}

/// The count at the start of `bytes`; `None` where they are too few.
pub(crate) fn count(bytes: &[u8], width: Width) -> Option<f64> {
    match width {
        Width::Byte => bytes.first().map(|b| f64::from(b.cast_signed())),
        Width::Word => bytes
            .first_chunk()
            .map(|b| f64::from(i16::from_be_bytes(*b))),
        Width::Long => bytes
            .first_chunk()
            .map(|b| f64::from(i32::from_be_bytes(*b))),
    }
}

/// Writes the nearest count that the width can hold at the start of `into`; what is no number becomes 0.
#[expect(clippy::cast_possible_truncation, reason = "a cast of f64 saturates")]
pub(crate) fn put(into: &mut [u8], width: Width, count: f64) {
    let count = count.round();
    let bytes = match width {
        Width::Byte => {
            let [byte] = (count as i8).to_be_bytes();
            [byte, 0, 0, 0]
        }
        Width::Word => {
            let [a, b] = (count as i16).to_be_bytes();
            [a, b, 0, 0]
        }
        Width::Long => (count as i32).to_be_bytes(),
    };
    let length = usize::from(width.bytes());
    if let Some(into) = into.get_mut(..length) {
        into.copy_from_slice(&bytes[..length]);
    }
}
