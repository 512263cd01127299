//! Addresses in the memory of the PMC, the programmable machine controller, and shifts as integer counts.

use std::fmt;

/// An area of PMC memory.
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
    /// Keep relays, whose values survive a power cut.
    K = 7,
    /// Counters of the ladder.
    C = 8,
    /// Data tables of the ladder.
    D = 9,
}

impl PmcArea {
    pub const ALL: [Self; 10] =
        [Self::G, Self::F, Self::Y, Self::X, Self::A, Self::R, Self::T, Self::K, Self::C, Self::D];

    /// Whether the area is the ladder's own memory, whose meaning only the ladder assigns. External programs may write
    /// only there, and barrier reports must be there.
    pub fn is_of_ladder(self) -> bool {
        matches!(self, Self::R | Self::D)
    }

    /// Contents of an area outside the ladder's own memory, for messages.
    pub(crate) fn holds(self) -> &'static str {
        match self {
            Self::G => {
                "G holds the signals to the control, its emergency stop among them, which the ladder alone sets"
            }
            Self::F => "F holds the signals of the control, which only the control writes",
            Self::Y => "Y holds the outputs to the machine",
            Self::X => "X holds the inputs from the machine",
            Self::A => "A holds the messages to the operator",
            Self::T => "T holds the times of the ladder's timers",
            Self::K => "K holds the settings of the ladder",
            Self::C => "C holds the counters of the ladder",
            Self::R | Self::D => "it is the ladder's own memory",
        }
    }

    /// The area with this letter; `None` if there is no such area.
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|area| format!("{area:?}").starts_with(letter.to_ascii_uppercase()))
    }
}

/// Size of one point of PMC memory: a signed number of one, two or four bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Width {
    Byte,
    #[default]
    Word,
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

    /// Largest magnitude that a signed point of this size can represent in both directions.
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PmcAddress {
    pub area: PmcArea,
    pub at: u16,
}

impl fmt::Display for PmcAddress {
    /// Formats the address as in ladders: `R100`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}{}", self.area, self.at)
    }
}

/// PMC addresses of a barrier's frame and report. Both are consecutive two-byte words, low byte first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct BarrierArea {
    /// First byte of the frame, which the driver writes and the ladder reads.
    pub frame: PmcAddress,
    /// First byte of the report, which the ladder writes and the driver reads.
    pub report: PmcAddress,
}

impl BarrierArea {
    /// Number of words in a frame for `axes` axes: epoch, tick, sequence, owner, one value per axis, two checksum
    /// words.
    pub const fn frame_words(axes: usize) -> usize {
        4 + axes + 2
    }

    /// Number of words in a report for `axes` axes: eight header words, three words per axis, two checksum words.
    pub const fn report_words(axes: usize) -> usize {
        8 + 3 * axes + 2
    }
}

/// A block of PMC memory and its purpose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Configuration key of the block's address: `area.first`, `heartbeat`, `sequence`, `referenced`, `barrier.frame`
    /// or `barrier.report`. Empty if the control determines the address.
    pub key: &'static str,
    /// Purpose of the bytes, in words.
    pub what: &'static str,
    pub first: PmcAddress,
    pub last: PmcAddress,
}

impl Block {
    /// First byte that both blocks contain; `None` if the blocks do not overlap.
    pub fn shared(&self, other: &Self) -> Option<PmcAddress> {
        let at = self.first.at.max(other.first.at);
        let is_in_both =
            self.first.area == other.first.area && at <= self.last.at && at <= other.last.at;
        is_in_both.then_some(PmcAddress { at, ..self.first })
    }
}

impl fmt::Display for Block {
    /// Formats purpose and addresses: `the words of the shifts R100 to R105`, `the heartbeat R120`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.what, self.first)?;
        if self.last != self.first {
            write!(f, " to {}", self.last)?;
        }
        Ok(())
    }
}

pub(crate) fn count(bytes: &[u8], width: Width) -> Option<f64> {
    match width {
        Width::Byte => bytes.first().map(|b| f64::from(b.cast_signed())),
        Width::Word => bytes.first_chunk().map(|b| f64::from(i16::from_be_bytes(*b))),
        Width::Long => bytes.first_chunk().map(|b| f64::from(i32::from_be_bytes(*b))),
    }
}

/// Encodes the nearest representable count at the start of `into`. NaN becomes 0.
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
