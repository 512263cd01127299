//! Error names of ISO 230-1, such as `EXX` and `EC0Y`.

use core::{fmt, str::FromStr};

use arrayvec::ArrayString;

use crate::axis::{AxisKind, AxisName};

/// One of the six components of an error: a translation along or a rotation about an axis of the machine coordinate
/// system.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Component {
    /// Translation along X, µm.
    EX,
    /// Translation along Y, µm.
    EY,
    /// Translation along Z, µm.
    EZ,
    /// Rotation about X, µrad.
    EA,
    /// Rotation about Y, µrad.
    EB,
    /// Rotation about Z, µrad.
    EC,
}

impl Component {
    /// All six components, in the order of ISO 230-1.
    pub const ALL: [Self; 6] = [Self::EX, Self::EY, Self::EZ, Self::EA, Self::EB, Self::EC];

    /// Index in [`Component::ALL`], 0 to 5.
    pub fn index(self) -> usize {
        self as usize
    }

    /// Whether the component is a rotation (µrad); otherwise it is a translation (µm).
    pub fn is_angular(self) -> bool {
        self.index() >= 3
    }

    /// Index 0, 1 or 2 of the axis X, Y or Z of the machine coordinate system along or about which the component acts.
    pub fn mcs_index(self) -> usize {
        self.index() % 3
    }

    /// Kind of axis whose errors have the unit of this component: linear (µm) for a translation, rotary (µrad) for a
    /// rotation.
    pub fn kind(self) -> AxisKind {
        if self.is_angular() { AxisKind::Rotary } else { AxisKind::Linear }
    }

    /// Unit in keys of files and responses: `um` or `urad`.
    pub fn unit(self) -> &'static str {
        self.kind().micro_unit()
    }

    /// Unit for display: `µm` or `µrad`.
    pub fn symbol(self) -> &'static str {
        self.kind().micro_symbol()
    }

    /// Letter after the E in an error name: X, Y, Z, A, B or C.
    pub fn letter(self) -> char {
        match self {
            Self::EX => 'X',
            Self::EY => 'Y',
            Self::EZ => 'Z',
            Self::EA => 'A',
            Self::EB => 'B',
            Self::EC => 'C',
        }
    }
}

/// Name of one error of one axis: `EYX` is the straightness error motion of X along Y, `EC0Y` the squareness of Y to X.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct ErrorName {
    pub component: Component,
    /// Axis whose motion or location has the error.
    pub axis: AxisName,
    /// True for a location error `E?0N` (a number), false for an error motion `E?N` (a curve).
    pub location: bool,
}

/// A text that is not an error name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "`{found}` is no error name, expected E, one of X Y Z A B C, 0 for a location error, and an axis: EXX, EC0Y"
)]
pub struct UnknownErrorName {
    /// The rejected text, truncated to 24 bytes.
    pub found: ArrayString<24>,
}

impl ErrorName {
    /// Name of the error motion `E?N` of `axis`.
    pub fn motion(component: Component, axis: AxisName) -> Self {
        Self { component, axis, location: false }
    }

    /// Name of the location error `E?0N` of `axis`.
    pub fn location(component: Component, axis: AxisName) -> Self {
        Self { component, axis, location: true }
    }
}

impl FromStr for ErrorName {
    type Err = UnknownErrorName;

    /// Parses `EXX`, `EC0Y` and the aliases `EC(0X)Y`, `EB(0X)Z`, `EA(0Y)Z`, `C0Y`, `X0C`.
    fn from_str(text: &str) -> Result<Self, UnknownErrorName> {
        let unknown = || {
            let mut found = ArrayString::new();
            for letter in text.chars() {
                if found.try_push(letter).is_err() {
                    break;
                }
            }
            UnknownErrorName { found }
        };
        let (component, axis, location) = match *text.as_bytes() {
            [b'E', component, b'(', b'0', reference, b')', axis] => {
                match (component, reference, axis) {
                    (b'C', b'X', b'Y') | (b'B', b'X', b'Z') | (b'A', b'Y', b'Z') => {
                        (component, axis, true)
                    }
                    _ => return Err(unknown()),
                }
            }
            [b'E', component, b'0', axis] | [component, b'0', axis] => (component, axis, true),
            [b'E', component, axis] => (component, axis, false),
            _ => return Err(unknown()),
        };
        let component =
            Component::ALL.into_iter().find(|known| known.letter() == char::from(component));
        Ok(Self {
            component: component.ok_or_else(unknown)?,
            axis: AxisName::from_letter(char::from(axis)).ok_or_else(unknown)?,
            location,
        })
    }
}

impl fmt::Display for ErrorName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let zero = if self.location { "0" } else { "" };
        write!(f, "E{}{zero}{}", self.component.letter(), self.axis)
    }
}
