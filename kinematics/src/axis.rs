//! Axis letters of ISO 841 and the two kinds of joint.

use core::fmt;

use nalgebra::Vector3;

/// The most axes a chain can have: one for each letter of [`AxisName`].
pub const MAX_AXES: usize = 9;

/// An axis letter of ISO 841.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum AxisName {
    /// Primary linear axis along +X.
    X,
    /// Primary linear axis along +Y.
    Y,
    /// Primary linear axis along +Z.
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

/// What an axis does: it slides or it turns.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum JointKind {
    /// Coordinate in mm.
    Linear,
    /// Coordinate in rad.
    Rotary,
}

impl AxisName {
    /// Every letter, in the order of ISO 841.
    pub const ALL: [Self; MAX_AXES] = [
        Self::X,
        Self::Y,
        Self::Z,
        Self::A,
        Self::B,
        Self::C,
        Self::U,
        Self::V,
        Self::W,
    ];

    /// The axis of an upper-case letter, `None` for any other character.
    pub fn from_letter(letter: char) -> Option<Self> {
        Self::ALL.into_iter().find(|name| name.letter() == letter)
    }

    /// The upper-case letter.
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
    pub fn kind(self) -> JointKind {
        match self {
            Self::A | Self::B | Self::C => JointKind::Rotary,
            _ => JointKind::Linear,
        }
    }

    /// Index 0, 1, 2 of the MCS axis that the letter belongs to.
    pub fn mcs_index(self) -> usize {
        match self {
            Self::X | Self::A | Self::U => 0,
            Self::Y | Self::B | Self::V => 1,
            Self::Z | Self::C | Self::W => 2,
        }
    }

    /// The unit direction that the letter stands for, in MCS.
    pub fn default_direction(self) -> Vector3<f64> {
        let mut direction = Vector3::zeros();
        direction[self.mcs_index()] = 1.0;
        direction
    }
}

impl fmt::Display for AxisName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.letter())
    }
}
