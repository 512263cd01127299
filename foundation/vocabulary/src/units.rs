//! Numbers with their unit. Public interfaces use these types; internal calculations use f64 in mm and rad.

use core::{
    fmt,
    ops::{Add, Div, Mul, Neg, Sub},
};

use crate::axis::AxisKind;

/// A number with a unit. Settings that are a length for linear and an angle for rotary axes are generic over this
/// trait.
pub trait Unit: Copy {
    /// Creates a quantity from a number in the unit of this type.
    fn of(number: f64) -> Self;
}

macro_rules! unit {
    ($(#[$doc:meta])* $name:ident, $symbol:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[repr(transparent)]
        pub struct $name(pub f64);

        impl $name {
            /// Symbol of the unit, for display.
            pub const SYMBOL: &'static str = $symbol;

            /// Absolute value, in the same unit.
            #[must_use]
            pub fn abs(self) -> Self {
                Self(self.0.abs())
            }

            /// False for NaN and infinity.
            pub fn is_finite(self) -> bool {
                self.0.is_finite()
            }
        }

        impl Unit for $name {
            fn of(number: f64) -> Self {
                Self(number)
            }
        }

        impl fmt::Display for $name {
            /// Writes the number, with the precision of the formatter, and the unit.
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.fmt(f)?;
                f.write_str(concat!(" ", $symbol))
            }
        }

        impl Add for $name {
            type Output = Self;
            fn add(self, other: Self) -> Self {
                Self(self.0 + other.0)
            }
        }

        impl Sub for $name {
            type Output = Self;
            fn sub(self, other: Self) -> Self {
                Self(self.0 - other.0)
            }
        }

        impl Neg for $name {
            type Output = Self;
            fn neg(self) -> Self {
                Self(-self.0)
            }
        }

        impl Mul<f64> for $name {
            type Output = Self;
            fn mul(self, factor: f64) -> Self {
                Self(self.0 * factor)
            }
        }

        impl Div<f64> for $name {
            type Output = Self;
            fn div(self, divisor: f64) -> Self {
                Self(self.0 / divisor)
            }
        }
    };
}

unit!(
    /// A length in millimetres: positions, points, travels.
    Mm,
    "mm"
);
unit!(
    /// A length in micrometres: linear errors and corrections.
    Um,
    "µm"
);
unit!(
    /// An angle in degrees: coordinates of rotary axes in files and displays.
    Deg,
    "deg"
);
unit!(
    /// An angle in radians: coordinates of rotary axes in memory.
    Rad,
    "rad"
);
unit!(
    /// An angle in microradians: angular errors and corrections.
    Urad,
    "µrad"
);
unit!(
    /// A temperature in degrees Celsius.
    Degc,
    "°C"
);

impl Mm {
    pub fn to_um(self) -> Um {
        Um(self.0 * 1e3)
    }
}

impl Um {
    pub fn to_mm(self) -> Mm {
        Mm(self.0 / 1e3)
    }
}

impl Deg {
    pub fn to_rad(self) -> Rad {
        Rad(self.0.to_radians())
    }
}

impl Rad {
    pub fn to_deg(self) -> Deg {
        Deg(self.0.to_degrees())
    }

    pub fn to_urad(self) -> Urad {
        Urad(self.0 * 1e6)
    }
}

impl Urad {
    pub fn to_rad(self) -> Rad {
        Rad(self.0 / 1e6)
    }
}

impl From<Um> for Mm {
    fn from(length: Um) -> Self {
        length.to_mm()
    }
}

impl From<Urad> for Rad {
    fn from(angle: Urad) -> Self {
        angle.to_rad()
    }
}

impl From<Deg> for Rad {
    fn from(angle: Deg) -> Self {
        angle.to_rad()
    }
}

/// A length or an angle, depending on the kind of the axis; used for coordinates, corrections, steps and limits.
/// Serialised as `{"mm": …}` or `{"rad": …}`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Displacement {
    /// Displacement of a linear axis.
    #[cfg_attr(feature = "serde", serde(rename = "mm"))]
    Length(Mm),
    /// Displacement of a rotary axis.
    #[cfg_attr(feature = "serde", serde(rename = "rad"))]
    Angle(Rad),
}

impl Displacement {
    /// Creates a displacement from a number in mm (linear axis) or rad (rotary axis).
    pub fn new(kind: AxisKind, mm_or_rad: f64) -> Self {
        match kind {
            AxisKind::Linear => Self::Length(Mm(mm_or_rad)),
            AxisKind::Rotary => Self::Angle(Rad(mm_or_rad)),
        }
    }

    /// Creates a displacement from a number in µm (linear axis) or µrad (rotary axis).
    pub fn from_micro(kind: AxisKind, um_or_urad: f64) -> Self {
        match kind {
            AxisKind::Linear => Self::Length(Um(um_or_urad).to_mm()),
            AxisKind::Rotary => Self::Angle(Urad(um_or_urad).to_rad()),
        }
    }

    /// Creates a displacement from a coordinate in a file, in mm (linear axis) or deg (rotary axis).
    pub fn from_coordinate(kind: AxisKind, mm_or_deg: f64) -> Self {
        match kind {
            AxisKind::Linear => Self::Length(Mm(mm_or_deg)),
            AxisKind::Rotary => Self::Angle(Deg(mm_or_deg).to_rad()),
        }
    }

    pub fn kind(self) -> AxisKind {
        match self {
            Self::Length(_) => AxisKind::Linear,
            Self::Angle(_) => AxisKind::Rotary,
        }
    }

    /// The number, in mm for a length and in rad for an angle.
    pub fn mm_or_rad(self) -> f64 {
        match self {
            Self::Length(Mm(number)) | Self::Angle(Rad(number)) => number,
        }
    }

    /// The number, in µm for a length and in µrad for an angle.
    pub fn um_or_urad(self) -> f64 {
        match self {
            Self::Length(length) => length.to_um().0,
            Self::Angle(angle) => angle.to_urad().0,
        }
    }

    /// The number in the unit of coordinates in files: mm for a length, deg for an angle.
    pub fn mm_or_deg(self) -> f64 {
        match self {
            Self::Length(length) => length.0,
            Self::Angle(angle) => angle.to_deg().0,
        }
    }
}

/// Displays a displacement as a coordinate: a length in mm, an angle in deg.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coordinate(pub Displacement);

impl fmt::Display for Coordinate {
    /// Writes the number and its unit. The formatter's precision applies; by default up to six decimals are shown.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Avoid showing 30 deg as 29.999999999999996.
        let number = match f.precision() {
            Some(_) => self.0.mm_or_deg(),
            None => rounded(self.0.mm_or_deg() * 1e3) / 1e3,
        };
        match self.0 {
            Displacement::Length(_) => Mm(number).fmt(f),
            Displacement::Angle(_) => Deg(number).fmt(f),
        }
    }
}

impl fmt::Display for Displacement {
    /// Writes a displacement as an error, correction or step, in µm or µrad. The formatter's precision applies; by
    /// default up to three decimals are shown. Use [`Coordinate`] for a position.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Avoid showing 17e-6 rad as 16.999999999999996 µrad.
        let micro = match f.precision() {
            Some(_) => self.um_or_urad(),
            None => rounded(self.um_or_urad()),
        };
        match self {
            Self::Length(_) => Um(micro).fmt(f),
            Self::Angle(_) => Urad(micro).fmt(f),
        }
    }
}

/// Rounds to three decimals; a number of magnitude 1e12 or more is unchanged.
fn rounded(value: f64) -> f64 {
    // Adding and subtracting 1.5·2⁵² rounds to a whole number without libm.
    const WHOLE: f64 = 6_755_399_441_055_744.0;
    let thousandths = value * 1e3;
    if thousandths.abs() < 1e15 { ((thousandths + WHOLE) - WHOLE) / 1e3 } else { value }
}
