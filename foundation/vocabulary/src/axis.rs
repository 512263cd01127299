//! Axis letters of ISO 841 and the two kinds of axis.

use core::{fmt, str::FromStr};

/// Maximum number of axes of a machine: one for each letter of [`AxisName`].
pub const MAX_AXES: usize = 9;

/// An axis letter of ISO 841.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AxisName {
    /// Primary linear axis along X.
    X,
    /// Primary linear axis along Y.
    Y,
    /// Primary linear axis along Z.
    Z,
    /// Rotary axis about X.
    A,
    /// Rotary axis about Y.
    B,
    /// Rotary axis about Z.
    C,
    /// Secondary linear axis parallel to X.
    U,
    /// Secondary linear axis parallel to Y.
    V,
    /// Secondary linear axis parallel to Z.
    W,
}

/// Kind of motion of an axis, which determines the unit of its coordinate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AxisKind {
    /// Translation; the coordinate is a length (mm).
    Linear,
    /// Rotation; the coordinate is an angle (rad in memory, deg in files).
    Rotary,
}

/// A text that is not an axis letter.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("expected one of the axis letters X Y Z A B C U V W")]
pub struct UnknownAxis;

impl AxisName {
    /// All letters, in the order in which volcomp lists axes: X Y Z A B C U V W.
    pub const ALL: [Self; MAX_AXES] =
        [Self::X, Self::Y, Self::Z, Self::A, Self::B, Self::C, Self::U, Self::V, Self::W];

    /// Axis with this upper-case letter; `None` for any other character.
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL.into_iter().find(|name| name.letter() == letter)
    }

    /// Upper-case letter of the axis.
    pub fn letter(self) -> char {
        match self {
            Self::X => 'X',
            Self::Y => 'Y',
            Self::Z => 'Z',
            Self::A => 'A',
            Self::B => 'B',
            Self::C => 'C',
            Self::U => 'U',
            Self::V => 'V',
            Self::W => 'W',
        }
    }

    /// Linear for X Y Z U V W, rotary for A B C.
    pub fn kind(self) -> AxisKind {
        match self {
            Self::A | Self::B | Self::C => AxisKind::Rotary,
            _ => AxisKind::Linear,
        }
    }

    /// Whether the axis is rotary: A, B or C.
    pub fn is_rotary(self) -> bool {
        self.kind() == AxisKind::Rotary
    }

    /// Index of the letter in [`AxisName::ALL`], 0 to 8.
    pub fn index(self) -> usize {
        self as usize
    }

    /// Index of X, Y or Z in the machine coordinate system: 0, 1 or 2. A rotary axis has the index of the axis about
    /// which it rotates, U, V and W those of X, Y and Z.
    pub fn mcs_index(self) -> usize {
        match self {
            Self::X | Self::A | Self::U => 0,
            Self::Y | Self::B | Self::V => 1,
            Self::Z | Self::C | Self::W => 2,
        }
    }
}

impl AxisKind {
    /// `linear` or `rotary`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Rotary => "rotary",
        }
    }

    /// Unit of a coordinate in files and displays: `mm` or `deg`.
    pub fn coordinate_unit(self) -> &'static str {
        match self {
            Self::Linear => "mm",
            Self::Rotary => "deg",
        }
    }

    /// Unit of an error or a correction in keys of files and responses: `um` or `urad`.
    pub fn micro_unit(self) -> &'static str {
        match self {
            Self::Linear => "um",
            Self::Rotary => "urad",
        }
    }

    /// Unit of an error or a correction for display: `µm` or `µrad`.
    pub fn micro_symbol(self) -> &'static str {
        match self {
            Self::Linear => "µm",
            Self::Rotary => "µrad",
        }
    }
}

impl fmt::Display for AxisName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.letter())
    }
}

impl fmt::Display for AxisKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for AxisName {
    type Err = UnknownAxis;

    /// Parses one upper-case letter.
    fn from_str(text: &str) -> Result<Self, UnknownAxis> {
        let mut letters = text.chars();
        match (letters.next(), letters.next()) {
            (Some(letter), None) => Self::from_letter(letter).ok_or(UnknownAxis),
            _ => Err(UnknownAxis),
        }
    }
}
