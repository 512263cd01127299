//! Numbers with their unit. Public edges take and give these; inside the kernels everything is f64 in mm and rad.

use core::{
    fmt,
    ops::{Add, Div, Mul, Neg, Sub},
};

use crate::axis::AxisKind;

/// A number with a unit, whatever the unit is: for settings that are the same for lengths and for angles.
pub trait Unit: Copy {
    /// The quantity of a number in this unit.
    fn of(number: f64) -> Self;
}

macro_rules! unit {
    ($(#[$doc:meta])* $name:ident, $symbol:literal) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq, PartialOrd)]
        #[repr(transparent)]
        pub struct $name(pub f64);

        impl $name {
            /// The unit as people read it.
            pub const SYMBOL: &'static str = $symbol;

            /// The size without the sign.
            #[must_use]
            pub fn abs(self) -> Self {
                Self(self.0.abs())
            }

            /// Whether it is a number and not infinite.
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
            /// The number, with the digits that the formatter asks for, and the unit.
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
    /// An angle in radians: coordinates of rotary axes inside.
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
    /// The same length in µm.
    pub fn to_um(self) -> Um {
        Um(self.0 * 1e3)
    }
}

impl Um {
    /// The same length in mm.
    pub fn to_mm(self) -> Mm {
        Mm(self.0 / 1e3)
    }
}

impl Deg {
    /// The same angle in rad.
    pub fn to_rad(self) -> Rad {
        Rad(self.0.to_radians())
    }
}

impl Rad {
    /// The same angle in deg.
    pub fn to_deg(self) -> Deg {
        Deg(self.0.to_degrees())
    }

    /// The same angle in µrad.
    pub fn to_urad(self) -> Urad {
        Urad(self.0 * 1e6)
    }
}

impl Urad {
    /// The same angle in rad.
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

/// A length or an angle, by the kind of the axis that it belongs to: a coordinate, a correction, a step, a limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Displacement {
    /// Of a linear axis.
    Length(Mm),
    /// Of a rotary axis.
    Angle(Rad),
}

impl Displacement {
    /// From a number in mm or rad, whichever the kind of axis has.
    pub fn new(kind: AxisKind, mm_or_rad: f64) -> Self {
        match kind {
            AxisKind::Linear => Self::Length(Mm(mm_or_rad)),
            AxisKind::Rotary => Self::Angle(Rad(mm_or_rad)),
        }
    }

    /// From a number in µm or µrad, whichever the kind of axis has.
    pub fn from_micro(kind: AxisKind, um_or_urad: f64) -> Self {
        match kind {
            AxisKind::Linear => Self::Length(Um(um_or_urad).to_mm()),
            AxisKind::Rotary => Self::Angle(Urad(um_or_urad).to_rad()),
        }
    }

    /// From a coordinate as files have it, in mm or deg.
    pub fn from_coordinate(kind: AxisKind, mm_or_deg: f64) -> Self {
        match kind {
            AxisKind::Linear => Self::Length(Mm(mm_or_deg)),
            AxisKind::Rotary => Self::Angle(Deg(mm_or_deg).to_rad()),
        }
    }

    /// Which kind of axis has it.
    pub fn kind(self) -> AxisKind {
        match self {
            Self::Length(_) => AxisKind::Linear,
            Self::Angle(_) => AxisKind::Rotary,
        }
    }

    /// The number in mm or rad.
    pub fn mm_or_rad(self) -> f64 {
        match self {
            Self::Length(Mm(number)) | Self::Angle(Rad(number)) => number,
        }
    }

    /// The number in µm or µrad.
    pub fn um_or_urad(self) -> f64 {
        match self {
            Self::Length(length) => length.to_um().0,
            Self::Angle(angle) => angle.to_urad().0,
        }
    }

    /// The number as a coordinate in files, in mm or deg.
    pub fn mm_or_deg(self) -> f64 {
        match self {
            Self::Length(length) => length.0,
            Self::Angle(angle) => angle.to_deg().0,
        }
    }
}

/// A displacement as people read a coordinate, with its unit: in mm, or in deg for a rotary axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coordinate(pub Displacement);

impl fmt::Display for Coordinate {
    /// With the digits that the formatter asks for (default: up to six), and the unit.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // 30 deg are 30 deg, not 29.999999999999996.
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
    /// An error, a correction or a step: in µm or µrad, with the digits that the formatter asks for (default: up to
    /// three), and the unit. A position is shown by [`Coordinate`].
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // 17e-6 rad are 17 µrad, not 16.999999999999996.
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

/// To three digits behind the point where that is exact in f64; other numbers stay as they are.
fn rounded(value: f64) -> f64 {
    // Adding and subtracting 1.5·2⁵² rounds to a whole number; libm is not needed for it.
    const WHOLE: f64 = 6_755_399_441_055_744.0;
    let thousandths = value * 1e3;
    if thousandths.abs() < 1e15 {
        ((thousandths + WHOLE) - WHOLE) / 1e3
    } else {
        value
    }
}
