//! Places in the memory of the PMC, the programmable machine controller.

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
    /// How many bytes a point has.
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
    /// The area of the memory.
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
