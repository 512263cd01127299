//! Axes: their letters by ISO 841, their two kinds, and their coordinates within a range.
//!
//! Values by axis are stored in machine order ([`PerAxis`]) or in channel order ([`PerChannel`]).

use core::{
    fmt,
    ops::{Deref, DerefMut},
    str::FromStr,
};

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

macro_rules! in_order {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
        #[repr(transparent)]
        pub struct $name<T>(pub [T; MAX_AXES]);

        impl<T> $name<T> {
            /// Creates the array from a function of the index, 0 to [`MAX_AXES`] − 1.
            #[inline]
            pub fn from_fn(value: impl FnMut(usize) -> T) -> Self {
                Self(core::array::from_fn(value))
            }

            /// Iterates over all [`MAX_AXES`] values in order, including those beyond the last axis.
            #[inline]
            pub fn iter(&self) -> core::slice::Iter<'_, T> {
                self.0.iter()
            }

            /// Iterates mutably over all [`MAX_AXES`] values in order, including those beyond the last axis.
            #[inline]
            pub fn iter_mut(&mut self) -> core::slice::IterMut<'_, T> {
                self.0.iter_mut()
            }

            /// These values, followed by default values. A call with more than [`MAX_AXES`] values does not compile.
            #[inline]
            pub fn leading<const N: usize>(values: [T; N]) -> Self
            where
                T: Default,
            {
                const { assert!(N <= MAX_AXES, "more values than a machine has axes") };
                let mut values = values.into_iter();
                Self::from_fn(|_| values.next().unwrap_or_default())
            }

            /// Applies a function to each of the [`MAX_AXES`] values, including those beyond the last axis.
            #[inline]
            pub fn map<U>(self, value: impl FnMut(T) -> U) -> $name<U> {
                $name(self.0.map(value))
            }
        }

        impl $name<f64> {
            /// Zero at every index.
            pub const ZERO: Self = Self([0.0; MAX_AXES]);
        }

        impl<T> Deref for $name<T> {
            type Target = [T; MAX_AXES];
            #[inline]
            fn deref(&self) -> &Self::Target {
                &self.0
            }
        }

        impl<T> DerefMut for $name<T> {
            #[inline]
            fn deref_mut(&mut self) -> &mut Self::Target {
                &mut self.0
            }
        }

        impl<T> From<[T; MAX_AXES]> for $name<T> {
            #[inline]
            fn from(values: [T; MAX_AXES]) -> Self {
                Self(values)
            }
        }

        impl<T> IntoIterator for $name<T> {
            type Item = T;
            type IntoIter = core::array::IntoIter<T, MAX_AXES>;
            #[inline]
            fn into_iter(self) -> Self::IntoIter {
                self.0.into_iter()
            }
        }

        impl<'a, T> IntoIterator for &'a $name<T> {
            type Item = &'a T;
            type IntoIter = core::slice::Iter<'a, T>;
            #[inline]
            fn into_iter(self) -> Self::IntoIter {
                self.0.iter()
            }
        }

        impl<'a, T> IntoIterator for &'a mut $name<T> {
            type Item = &'a mut T;
            type IntoIter = core::slice::IterMut<'a, T>;
            #[inline]
            fn into_iter(self) -> Self::IntoIter {
                self.0.iter_mut()
            }
        }
    };
}

in_order! {
    /// One value for each axis of a machine, in *machine order*: the order of the kinematic chain from the workpiece to
    /// the tool. Coordinates and corrections are in mm for linear and in rad for rotary axes. Entries beyond the last
    /// axis hold the default value.
    PerAxis
}

in_order! {
    /// One value for each axis that a controller writes, in *channel order*: the order of the axes in the controller's
    /// description. Positions and corrections are in mm for linear and in rad for rotary axes. Entries beyond the last
    /// axis hold the default value. The type differs from [`PerAxis`], so that the two orders cannot be confused.
    PerChannel
}

/// Tolerance at the ends of a range, mm or deg. It covers the last digits that change when an end of travel is
/// converted to radians or rounded in a controller. No machine tool resolves 1e-9 mm or 1e-9 deg.
pub const COORDINATE_ROUNDING: f64 = 1e-9;

/// Whether a coordinate is in a range, including both ends, with the tolerance [`COORDINATE_ROUNDING`]; false for NaN.
/// Range and coordinate are both in mm or both in deg.
#[inline]
pub fn is_within([low, high]: [f64; 2], coordinate: f64) -> bool {
    low - COORDINATE_ROUNDING <= coordinate && coordinate <= high + COORDINATE_ROUNDING
}

/// Moves a rotary coordinate into `travel` by whole periods; all in deg. A coordinate that is within the travel, with
/// the tolerance [`COORDINATE_ROUNDING`], is unchanged, so that a coordinate at one end of the travel does not move to
/// the other end.
#[inline]
pub fn brought_into(travel: [f64; 2], period: f64, coordinate: f64) -> f64 {
    if is_within(travel, coordinate) {
        return coordinate;
    }
    // `core` has no Euclidean remainder.
    let rest = (coordinate - travel[0]) % period;
    travel[0] + if rest < 0.0 { rest + period } else { rest }
}
